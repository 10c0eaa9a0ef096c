/* The address of what the page shows. The scroll position is kept for each step.

   The server names the address (`show`) and says when a step is drawn (`drawn`). Back and forth are
   told to it by the event "went". */
const addresses = {
  /* Where each step was scrolled to [px], kept while the window is. */
  places: JSON.parse(sessionStorage.getItem("places") ?? "{}"),
  wanted: null, // where the step that is being drawn is to be scrolled to
  went: 0, // how often the user went back or forth in this page

  /* The page shows another step, or another selection in it: only a step can be gone back to.
     went: the last one that the server had heard of. What it drew before is an address no more. */
  show(text, title, went) {
    if (went < addresses.went) return;
    const { pathname } = new URL(text, location.href);
    if (title) document.title = title;
    if (location.pathname + location.search === text) return;
    if (pathname === location.pathname || location.pathname === "/")
      history.replaceState(null, "", text);
    else {
      history.pushState(null, "", text);
      addresses.wanted = addresses.places[pathname] ?? 0;
    }
  },

  /* A step is drawn: scroll to where it was, as soon as it is so long. */
  drawn() {
    const wanted = addresses.wanted ?? addresses.places[location.pathname] ?? 0;
    addresses.wanted = wanted;
    const until = performance.now() + 1500;
    const scroll = () => {
      if (addresses.wanted !== wanted) return;
      scrollTo(0, wanted);
      if (Math.abs(scrollY - wanted) < 2 || performance.now() > until) addresses.wanted = null;
      else requestAnimationFrame(scroll);
    };
    requestAnimationFrame(() => requestAnimationFrame(scroll));
  },

  note() {
    if (addresses.wanted !== null) return; // not the user's
    addresses.places[location.pathname] = scrollY;
    sessionStorage.setItem("places", JSON.stringify(addresses.places));
  },
};

history.scrollRestoration = "manual";
addEventListener("click", ({ target }) => {
  if (!target.closest(".step")) return;
  addresses.note();
  addresses.wanted = 0; // the step goes before its address does: what it scrolls to is no place
}, true);
addEventListener("scrollend", addresses.note);
for (const event of ["wheel", "touchmove", "keydown", "pointerdown"])
  addEventListener(event, () => (addresses.wanted = null), { passive: true });
addEventListener("popstate", () => {
  addresses.wanted = addresses.places[location.pathname] ?? 0;
  const went = ++addresses.went;
  emitEvent("went", { path: location.pathname, query: location.search.slice(1), went });
});
