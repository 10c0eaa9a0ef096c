/* One selection of poses in all figures of a page. Only marks change; no figure is drawn anew.

   A figure takes part by its class "linked". Its first trace has the positions of its poses as
   customdata; those of poses that no fit uses have none. In space, a second trace rings the selected
   poses. */
const linked = {
  chosen: [],
  waiting: 0,

  last: null,
  frames: false,
  shift: false,

  /* Select these poses; in space once all else is seen: without a graphics processor that takes as
     long as all else together. */
  select(positions) {
    linked.chosen = positions;
    for (const figure of document.querySelectorAll(".linked.js-plotly-plot"))
      if (figure.data?.[0].type === "scatter") linked.mark(figure);
    linked.overlay();
    cancelIdleCallback(linked.waiting);
    linked.waiting = requestIdleCallback(linked.ring, { timeout: 200 });
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

  /* Ring the selected poses in space: the marks alone, where they were drawn before. */
  ring() {
    const chosen = new Set(linked.chosen);
    for (const figure of document.querySelectorAll(".linked.js-plotly-plot")) {
      const [trace, ring] = figure.data ?? [];
      if (ring?.meta !== "ring") continue;
      const where = trace.customdata.flatMap((position, i) => (chosen.has(position) ? [i] : []));
      const axes = ["x", "y", "z"].filter((k) => trace[k]);
      const at = Object.fromEntries(axes.map((k) => [k, where.map((i) => trace[k][i])]));
      const scene = figure._fullLayout.scene?._scene;
      const drawn = scene?.traces[figure._fullData[1].uid];
      if (!drawn) {
        const moved = Object.fromEntries(axes.map((k) => [k, [at[k]]]));
        linked.plotly((Plotly) => Plotly.restyle(figure, moved, [1]));
        continue;
      }
      Object.assign(ring, at);
      drawn.update(Object.assign(figure._fullData[1], at));
      scene.glplot.redraw();
    }
  },

  /* Whether a drag in space draws a frame, instead of turning it. */
  framing(on) {
    linked.frames = on;
    linked.overlay();
  },

  /* A pane over each figure in space that takes the frame, where one is drawn. */
  overlay() {
    for (const figure of document.querySelectorAll(".linked.js-plotly-plot")) {
      const scene = figure._fullLayout?.scene?._scene;
      if (!scene) continue;
      let pane = figure.querySelector(".pane");
      if (!pane) {
        pane = document.createElement("div");
        pane.className = "pane";
        pane.addEventListener("pointerdown", (event) => linked.frame(figure, pane, event));
        figure.append(pane);
        linked.hear(figure);
      }
      const box = scene.container.getBoundingClientRect(), all = figure.getBoundingClientRect();
      Object.assign(pane.style, {
        display: linked.frames ? "block" : "none",
        left: `${box.left - all.left}px`,
        top: `${box.top - all.top}px`,
        width: `${box.width}px`,
        height: `${box.height}px`,
      });
    }
  },

  /* A click with Shift in space, which plotly keeps to itself. */
  hear(figure) {
    let under = null;
    figure.on("plotly_hover", (event) => (under = event.points[0]));
    figure.on("plotly_unhover", () => (under = null));
    figure.addEventListener("pointerup", (event) => {
      if (event.shiftKey && under) figure.emit("plotly_click", { points: [under] });
    }, true);
  },

  /* Draw a frame from here, and select the poses that are seen inside of it. */
  frame(figure, pane, begin) {
    const drawn = document.createElement("div");
    pane.replaceChildren(drawn);
    pane.setPointerCapture(begin.pointerId);
    const ends = (event) => {
      const box = pane.getBoundingClientRect();
      const ends = [begin, event].map((e) => [e.clientX - box.left, e.clientY - box.top]);
      const [x, y] = [0, 1].map((k) => ends.map((end) => end[k]).sort((a, b) => a - b));
      return { x, y, box };
    };
    pane.onpointermove = (event) => {
      const { x, y } = ends(event);
      const at = { left: x[0], top: y[0], width: x[1] - x[0], height: y[1] - y[0] };
      for (const [name, size] of Object.entries(at)) drawn.style[name] = `${size}px`;
    };
    pane.onpointerup = (event) => {
      pane.onpointermove = pane.onpointerup = null;
      pane.replaceChildren();
      const { x, y, box } = ends(event);
      const range = {
        x: x.map((v) => (2 * v) / box.width - 1),
        y: y.map((v) => 1 - (2 * v) / box.height).reverse(),
        matrix: linked.matrix(figure._fullLayout.scene._scene),
      };
      const { data: [trace] } = figure;
      const inside = trace.customdata.flatMap((position, i) => {
        const [u, v, , w] = linked.times(range.matrix, [trace.x[i], trace.y[i], trace.z[i], 1]);
        const within = (value, [low, high]) => low <= value / w && value / w <= high;
        return within(u, range.x) && within(v, range.y) ? [position] : [];
      });
      if (inside.length) {
        const points = inside.map((customdata) => ({ customdata }));
        figure.emit("plotly_selected", { points, range });
      } else figure.emit("plotly_deselect");
    };
  },

  /* What takes a point [of the data] to the screen: 16 numbers, column by column. */
  matrix(scene) {
    const { projection, view, model } = scene.glplot.cameraParams;
    const units = [0, 1, 2, 3].map((k) => [0, 1, 2, 3].map((i) => (i === k ? 1 : 0)));
    return units.flatMap((unit) => {
      const scaled = unit.map((value, i) => value * (scene.dataScale[i] ?? 1));
      return [model, view, projection].reduce((point, m) => linked.times(m, point), scaled);
    });
  },

  times(matrix, point) {
    return [0, 1, 2, 3].map((row) => point.reduce((sum, v, k) => sum + matrix[4 * k + row] * v, 0));
  },

  async plotly(use) {
    use((await import("nicegui-plotly")).Plotly);
  },
};

addEventListener("pointerdown", (event) => (linked.shift = event.shiftKey), true);

/* A figure that left the page would draw on, in space with every frame of the screen. One that left
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
