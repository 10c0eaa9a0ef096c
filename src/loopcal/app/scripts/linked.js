/* One selection of poses in all figures of a page. Only marks change; no figure is drawn anew.

   A figure takes part by its class "linked". Its first trace has the positions of its poses as
   customdata. In space, the second trace rings the selected poses. */
const linked = {
  chosen: [],

  /* Select these poses. */
  select(positions) {
    linked.chosen = positions;
    for (const figure of document.querySelectorAll(".linked.js-plotly-plot"))
      if (figure.data?.[0].type === "scatter") linked.mark(figure);
    requestAnimationFrame(linked.ring); // space is slower to draw: marks come first
  },

  /* Take the selection of an event of plotly and tell it on. Where an event has neither points nor
     a frame, nobody has selected: plotly has drawn a figure again. */
  take(event, emit) {
    if (!event?.points.length && !event?.range) return;
    const positions = event.points.map((point) => point.customdata);
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
    const { color } = trace.marker;
    for (const point of figure.querySelectorAll(".trace:first-child path.point")) {
      const on = !some || marked.has(point.__data__.i);
      point.style.fillOpacity = 1; // plotly keeps the alpha of a colour there
      if (typeof color !== "string") point.style.opacity = on ? 1 : trace.unselected.marker.opacity;
      else if (!some) point.style.fill = color;
      else point.style.fill = (on ? trace.selected : trace.unselected).marker.color;
    }
  },

  /* Ring the selected poses in space. */
  ring() {
    const chosen = new Set(linked.chosen);
    for (const figure of document.querySelectorAll(".linked.js-plotly-plot")) {
      const [trace, ring] = figure.data ?? [];
      if (!ring) continue;
      const where = trace.customdata.flatMap((position, i) => (chosen.has(position) ? [i] : []));
      const at = Object.fromEntries(
        ["x", "y", "z"].filter((k) => trace[k]).map((k) => [k, [where.map((i) => trace[k][i])]]),
      );
      linked.plotly((Plotly) => Plotly.restyle(figure, at, [1]));
    }
  },

  async plotly(use) {
    use((await import("nicegui-plotly")).Plotly);
  },
};
