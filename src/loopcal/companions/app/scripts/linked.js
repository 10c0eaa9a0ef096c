/* One selection of poses in all figures of a page. Only marks change; no figure is drawn anew.

   A figure takes part by its class "linked". Its first trace has the positions of its poses as
   customdata; those of poses that no fit uses have none. The one in space is drawn by space.js. */
const linked = {
  chosen: [],
  waiting: 0,

  last: null,
  frames: false,
  shift: false,

  /* Select these poses. */
  select(positions) {
    linked.chosen = positions;
    for (const figure of document.querySelectorAll(".linked.js-plotly-plot")) if (figure.data) linked.mark(figure);
    for (const figure of document.querySelectorAll(".linked.space")) figure.space.mark(positions);
  },

  /* Take the selection of an event of plotly and tell it on. An event without points and frame is
     no selection: plotly sends it when it draws a figure again. A click with Shift selects all poses
     since the last click. */
  take(event, emit) {
    if (!event?.points.length && !event?.range) return;
    let positions = event.points.map((point) => point.customdata).filter((one) => one != null);
    if (!event.range && !positions.length) return; // a pose that the fit does not use
    if (!event.range && positions.length === 1) {
      const [begin, end] = [linked.last ?? positions[0], positions[0]].sort((a, b) => a - b);
      if (!linked.shift) linked.last = positions[0];
      else positions = Array.from({ length: end - begin + 1 }, (_, i) => begin + i);
    }
    linked.select(positions);
    requestAnimationFrame(linked.unframe);
    emit(positions, event.range ?? null);
  },

  /* Select no pose. */
  none(emit) {
    linked.select([]);
    emit([], null);
  },

  /* Remove the frame of a brush: inside of it no other brush could begin. */
  unframe() {
    for (const figure of document.querySelectorAll(".linked.js-plotly-plot")) {
      for (const layout of [figure.layout, figure._fullLayout]) if (layout) layout.selections = [];
      const frames = ".selectionlayer path, .select-outline, .outline-controllers";
      for (const frame of figure.querySelectorAll(frames)) frame.remove();
    }
  },

  /* A value of a style as the browser writes it. */
  written(name, value) {
    const { style } = document.createElement("i");
    style[name] = value;
    return style[name];
  },

  /* Mark the points of a flat figure, now and where plotly draws it again. */
  mark(figure) {
    const some = linked.chosen.length > 0;
    const chosen = new Set(linked.chosen);
    const [trace] = figure.data;
    const where = trace.customdata.flatMap((position, i) => (chosen.has(position) ? [i] : []));
    const marked = new Set(where);
    trace.selectedpoints = figure._fullData[0].selectedpoints = some ? where : undefined;
    for (const [i, point] of figure.calcdata[0].entries())
      point.selected = marked.has(i) ? 1 : undefined;
    const { color } = trace.marker, { selected, unselected } = trace;
    // plotly keeps the alpha of a colour in the opacity
    const [on, off] = typeof color === "string"
      ? [some ? selected.marker.color : color, unselected.marker.color].map((fill) => ({ fill, fillOpacity: 1 }))
      : [1, unselected.marker.opacity].map((opacity) => ({ opacity, fillOpacity: 1 }));
    const looks = [off, on].map((look) => Object.entries(look).map(([name, value]) => [name, linked.written(name, value)]));
    for (const { style, __data__ } of figure.querySelectorAll(".trace:first-child path.point"))
      for (const [name, value] of looks[+(!some || marked.has(__data__.i))])
        if (style[name] !== value) style[name] = value; // the browser looks again at all that is set
  },

  /* The pose that is pointed at in a figure: marked in space at once, and told on after a while. */
  point(event, emit) {
    const position = event?.points?.[0]?.customdata ?? null;
    for (const figure of document.querySelectorAll(".linked.space")) figure.space.point(position);
    clearTimeout(linked.waiting);
    linked.waiting = setTimeout(() => emit(position), 60);
  },

  /* Whether a drag in space draws a frame, instead of turning it. */
  framing(on) {
    linked.frames = on;
  },

  async plotly(use) {
    use((await import("nicegui-plotly")).Plotly);
  },
};

addEventListener("pointerdown", (event) => (linked.shift = event.shiftKey), true);

/* A figure that left the page would be kept, and drawn with every new size of the window. One that left
   while it was drawn the first time is drawn to its end afterwards. */
const gone = new MutationObserver((changes) => {
  for (const figure of new Set(changes.map(({ target }) => target.closest(".plot")))) purge(figure);
});
const purge = (figure) => linked.plotly((Plotly) => {
  if (figure?.data && !figure.isConnected) Plotly.purge(figure);
});
new MutationObserver((changes) => {
  const nodes = changes.flatMap((change) => [...change.removedNodes]).filter((node) => node.querySelectorAll);
  for (const figure of nodes.flatMap((node) => [node, ...node.querySelectorAll(".plot")]))
    if (figure.matches(".plot") && !figure.isConnected) {
      gone.observe(figure, { childList: true, subtree: true });
      purge(figure);
    }
}).observe(document, { childList: true, subtree: true });

// NiceGUI watches the size of a figure once plotly is loaded, also of one that has left the page by then.
addEventListener("unhandledrejection", (event) => {
  if (event.reason?.message === "Resize must be passed a displayed plot div element.") event.preventDefault();
});
