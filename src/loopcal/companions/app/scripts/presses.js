/* A press counts, and the focus stays, also where a button is drawn anew or moved meanwhile.

   A browser sends a click only to what lies under the pointer both when it goes down and when it
   goes up, and a key only to what has the focus. Leaving a field can draw the page anew between the
   two. The button that is then drawn in the same place, found by its name, gets click and focus. */
const presses = {
  down: null, // { node, name, among, at, x, y }: the button that is being pressed
  held: null, // the one with the focus

  kinds: "button, a, [role=button], [role=checkbox], [role=option], [role=radio], [role=switch]",
  still: 8, // a pointer that has moved farther was taken away [px]

  named: (name) => [...document.querySelectorAll(presses.kinds)].filter(
    (node) => presses.name(node) === name),

  name: (node) => node.getAttribute("aria-label") ?? node.textContent.trim(),

  of(target) {
    const node = target.closest?.(presses.kinds);
    if (!node) return null;
    const name = presses.name(node);
    const alike = presses.named(name);
    return { node, name, among: alike.length, at: alike.indexOf(node) };
  },

  /* The button as it is drawn now; none where it is not certain which one it is. */
  now({ node, name, among, at }) {
    if (node.isConnected) return node;
    const alike = presses.named(name);
    return alike.length === among ? alike[at] : null;
  },

  pass() {
    const { held } = presses;
    if (!held || held.node.isConnected || document.activeElement !== document.body) return;
    presses.now(held)?.focus({ preventScroll: true });
  },
};

addEventListener("pointerdown", ({ target, button, pointerType, clientX: x, clientY: y }) => {
  const pressed = button === 0 && pointerType === "mouse" ? presses.of(target) : null;
  presses.down = pressed && { ...pressed, x, y };
}, true);
addEventListener("pointerup", ({ target, clientX, clientY }) => {
  const { down } = presses;
  presses.down = null;
  if (!down || Math.hypot(clientX - down.x, clientY - down.y) > presses.still) return;
  if (!down.node.isConnected || !down.node.contains(target)) presses.now(down)?.click();
}, true);
addEventListener("keydown", ({ target, key, repeat }) => {
  // a link is followed while its key is still down
  const pressed = (key === "Enter" || key === " ") && !target.closest("a");
  if (!repeat) presses.down = pressed ? presses.of(target) : null;
}, true);
addEventListener("keyup", () => {
  const { down } = presses;
  presses.down = null;
  if (down && !down.node.isConnected) presses.now(down)?.click();
}, true);
addEventListener("focusin", ({ target }) => (presses.held = presses.of(target)));
new MutationObserver(() => presses.pass()).observe(document, { childList: true, subtree: true });
