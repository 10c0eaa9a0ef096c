/* A figure in space on a plain canvas, which turns smoothly without a graphics processor.

   options: data, traces as plotly names them (scatter3d: markers, lines, text; mesh3d), and layout
   with scene {low, high}, the ends of the axes, or none for those of the data. A drag turns it, or
   draws a frame where linked.frames says so; a click names a point; the wheel zooms once the figure
   has the focus, so that it never keeps the page from scrolling. Its element has it as `space`. */
const FOCAL = 3.2; // distance of the eye over the half diagonal of the box
const NEAR = 10; // pixels within which a point is pointed at
const TEXT = "12px system-ui, 'Segoe UI', 'Noto Sans', sans-serif";
const VIRIDIS = ["440154", "482878", "3e4a89", "31688e", "26828e", "1f9e89", "35b779", "6ece58", "b5de2b", "fde725"]
  .map((hex) => [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16)));

const shade = (share) => {
  const at = Math.min(Math.max(share || 0, 0), 1) * (VIRIDIS.length - 1), i = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return `rgb(${[0, 1, 2].map((k) => Math.round(VIRIDIS[i][k] + (at - i) * (VIRIDIS[i + 1][k] - VIRIDIS[i][k])))})`;
};
const points = (trace) => [trace.x, trace.y, trace.z].map((v) => Float64Array.from(v, (one) => one ?? NaN));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/* Round numbers from low to high, about so many. */
function ticks(low, high, many) {
  const raw = (high - low) / many, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= raw * 0.999);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), every = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step)
    every.push([v, (Math.abs(v) < step / 2 ? 0 : v).toFixed(digits)]);
  return every;
}

export default {
  template: `<div class="space" tabindex="0"><canvas></canvas><div class="frame"></div><div class="tip"></div></div>`,
  props: { options: Object },
  mounted() {
    this.$el.space = this;
    Object.assign(this, { yaw: 0.8, pitch: 0.42, zoom: 1, shift: [0, 0], pointers: new Map(), pointed: null });
    [this.canvas, this.frame, this.tip] = this.$el.children;
    this.body = document.createElement("canvas");
    this.load();
    this.watching = new ResizeObserver(() => this.fit());
    this.watching.observe(this.$el);
    this.ground = matchMedia("(prefers-color-scheme: dark)");
    this.ground.addEventListener("change", this.redraw);
    for (const kind of ["down", "move", "up", "cancel", "leave"])
      this.$el.addEventListener(`pointer${kind}`, (event) => this[kind](event));
    this.$el.addEventListener("contextmenu", (event) => event.preventDefault());
    this.$el.addEventListener("keydown", (event) => this.key(event));
    this.$el.addEventListener("wheel", (event) => {
      if (document.activeElement !== this.$el) return;
      event.preventDefault();
      this.nearer(Math.exp(-0.0015 * event.deltaY));
    }, { passive: false });
  },
  unmounted() {
    this.watching.disconnect();
    this.ground.removeEventListener("change", this.redraw);
    cancelAnimationFrame(this.asked);
  },
  watch: { options() { this.load(); } },
  methods: {
    /* Take other traces; the eye stays where it is. */
    load() {
      const { data, layout } = this.options;
      this.depth = null;
      this.note = layout.annotations?.[0]?.text ?? "";
      this.traces = data.map((trace) => {
        const made = { trace, at: points(trace) };
        if (trace.type === "mesh3d") made.faces = [trace.i, trace.j, trace.k].map((v) => Int32Array.from(v));
        else if (trace.customdata) {
          this.poses = made;
          this.chosen = new Set((trace.selectedpoints ?? []).map((i) => trace.customdata[i]));
        }
        const { color, cmax } = trace.marker ?? {};
        if (Array.isArray(color)) {
          const cmin = trace.marker.cmin ?? Math.min(...color);
          made.ends = [cmin, cmax ?? (Math.max(...color) || 1)];
          made.colours = color.map((v) => shade(((v ?? cmin) - cmin) / (made.ends[1] - cmin)));
        }
        return made;
      });
      this.boxed(layout.scene?.low, layout.scene?.high);
    },
    /* Move traces: update {x, y, z} of lists, as plotly's restyle takes them. */
    restyle(update, which) {
      which.forEach((number, i) => {
        const [x, y, z] = [update.x[i], update.y[i], update.z[i]];
        Object.assign(this.traces[number], { at: points({ x, y, z }), sight: null });
      });
      this.boxed(this.low, this.high);
    },
    run_plot_method(name, ...args) { this[name](...args); },
    /* The box of the axes: as stated, and wider where something lies outside of it. */
    boxed(low, high) {
      const ends = [0, 1, 2].map((k) => {
        let [a, b] = low ? [low[k], high[k]] : [Infinity, -Infinity];
        for (const { at } of this.traces) for (const v of at[k]) { if (v < a) a = v; if (v > b) b = v; }
        return a <= b ? [a, b] : [-0.5, 0.5];
      });
      const wide = Math.max(...ends.map(([a, b]) => b - a)) || 1;
      // An arm in a plane has no extent across it.
      const full = ends.map(([a, b]) => (b - a < 0.4 * wide ? [(a + b) / 2 - 0.2 * wide, (a + b) / 2 + 0.2 * wide] : [a, b]));
      this.low = full.map(([a]) => a);
      this.high = full.map(([, b]) => b);
      this.fit();
    },
    /* The scale at which the box fills the place. */
    fit() {
      this.size = [this.$el.clientWidth, this.$el.clientHeight];
      this.bar = this.traces.find(({ trace }) => trace.marker?.colorbar);
      this.middle = this.low.map((v, k) => (v + this.high[k]) / 2);
      this.far = FOCAL * 0.5 * Math.hypot(...this.low.map((v, k) => this.high[k] - v));
      const [width, height] = this.room();
      const axes = this.axes(), across = [0, 1].map(() => [Infinity, -Infinity]);
      for (let i = 0; i < 8; i++) {
        const corner = this.middle.map((_, k) => (i >> k & 1 ? this.high : this.low)[k]), seen = this.seen(axes, ...corner);
        across.forEach((ends, k) => {
          ends[0] = Math.min(ends[0], seen[k] / seen[2]);
          ends[1] = Math.max(ends[1], seen[k] / seen[2]);
        });
      }
      const [[left, right], [bottom, top]] = across;
      this.scale = Math.max(1, Math.min((width - (this.narrow() ? 70 : 100)) / (right - left), (height - 80) / (top - bottom)));
      this.centre = [width / 2 - this.scale * (left + right) / 2, height / 2 + this.scale * (bottom + top) / 2];
      this.redraw();
    },
    /* Where the middle of the box is seen. */
    origin() {
      const [width, height] = this.room();
      return [width, height].map((v, k) => v / 2 + this.zoom * (this.centre[k] - v / 2) + this.shift[k]);
    },
    narrow() { return this.size[0] < 500; },
    room() { return [this.size[0] - (this.bar ? (this.narrow() ? 44 : 60) : 0), this.size[1]]; },
    /* Right, up and toward the eye, in the axes of the data. */
    axes() {
      const [c, s, C, S] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
      return [[-s, c, 0], [-S * c, -S * s, C], [C * c, C * s, S]];
    },
    seen([right, up, toward], x, y, z) {
      const p = [x - this.middle[0], y - this.middle[1], z - this.middle[2]];
      const along = (a) => a[0] * p[0] + a[1] * p[1] + a[2] * p[2];
      return [along(right), along(up), this.far - along(toward)];
    },
    /* Pixel and depth of points (3, n), as one flat list. */
    placed(axes, [x, y, z]) {
      const [left, top] = this.origin(), scale = this.scale * this.zoom, at = new Float64Array(3 * x.length);
      const [[a, b, c], [d, e, f], [g, h, k]] = axes, [u, v, w] = this.middle;
      for (let i = 0; i < x.length; i++) {
        const X = x[i] - u, Y = y[i] - v, Z = z[i] - w, depth = this.far - (g * X + h * Y + k * Z);
        at[3 * i] = left + scale * (a * X + b * Y + c * Z) / depth;
        at[3 * i + 1] = top - scale * (d * X + e * Y + f * Z) / depth;
        at[3 * i + 2] = depth;
      }
      return at;
    },
    /* What takes a point of the data to -1..1 across the place: 16 numbers, column by column. */
    matrix() {
      const [right, up, toward] = this.axes(), [W, H] = this.size, [left, top] = this.origin();
      const scale = 2 * this.scale * this.zoom, level = (a) => -a.reduce((sum, v, k) => sum + v * this.middle[k], 0);
      const depth = [...toward.map((v) => -v), this.far - level(toward)];
      const x0 = 2 * left / W - 1, y0 = 1 - 2 * top / H;
      const rows = [
        [...right, level(right)].map((v, i) => v * scale / W + x0 * depth[i]),
        [...up, level(up)].map((v, i) => v * scale / H + y0 * depth[i]), depth, depth];
      return [0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column]));
    },
    redraw() { this.asked ??= requestAnimationFrame(() => { this.asked = null; this.draw(); }); },
    draw() {
      const [w, h] = this.size;
      if (!w || !h || !this.$el.isConnected) return;
      // While it moves no pixel is drawn twice; at rest edges are smooth.
      const fine = this.moving ? 1 : Math.max(devicePixelRatio, 1);
      for (const [name, length] of [["width", w], ["height", h]])
        if (this.canvas[name] !== Math.round(length * fine)) this.canvas[name] = Math.round(length * fine);
      const g = this.canvas.getContext("2d"), style = getComputedStyle(this.$el);
      [this.ink, this.paper, this.line] = ["--none", "--paper", "--line"].map((name) => style.getPropertyValue(name).trim());
      g.setTransform(fine, 0, 0, fine, 0, 0);
      g.clearRect(0, 0, w, h);
      g.font = TEXT;
      const axes = this.axes(), labels = [];
      this.floor(g, axes, labels);
      for (const one of this.traces) one.seen = this.placed(axes, one.at);
      for (const one of this.traces) if (one.faces) this.mesh(g, axes, one, this.moving ? 1 : 2 * fine);
      for (const one of this.traces) if (!one.faces && one.trace.mode.includes("lines")) this.lines(g, one);
      for (const one of this.traces) if (!one.faces && one.trace.mode.includes("markers")) this.markers(g, one);
      this.rings(g);
      this.dark = document.body.classList.contains("body--dark");
      for (const one of this.traces) if (!one.faces && one.trace.mode.includes("text")) this.named(one, labels);
      this.write(g, labels);
      if (this.bar) this.colourbar(g);
      g.fillStyle = this.ink;
      g.textAlign = "left";
      const sentences = this.narrow() ? this.note.split(/(?<=[:,]) /) : [this.note];
      sentences.forEach((line, i) => g.fillText(line, 4, 14 + 16 * i));
    },
    /* The grid on the floor and an upright axis, with their numbers. */
    floor(g, axes, labels) {
      const { low, high, middle } = this, wide = Math.max(...low.map((v, k) => high[k] - v));
      const every = [0, 1, 2].map((k) => ticks(low[k], high[k], Math.max(2, Math.round(6 * (high[k] - low[k]) / wide))));
      const at = (x, y, z) => this.placed(axes, [[x], [y], [z]]);
      const front = [0, 1].map((k) => (axes[2][k] > 0 ? high : low)[k]), z = low[2];
      g.strokeStyle = this.line;
      g.lineWidth = 1;
      g.beginPath();
      const stroke = (a, b) => { g.moveTo(a[0], a[1]); g.lineTo(b[0], b[1]); };
      for (const x of [low[0], high[0], ...every[0].map(([v]) => v)]) stroke(at(x, low[1], z), at(x, high[1], z));
      for (const y of [low[1], high[1], ...every[1].map(([v]) => v)]) stroke(at(low[0], y, z), at(high[0], y, z));
      const corners = [[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]];
      const [left] = corners.sort((a, b) => at(...a, z)[0] - at(...b, z)[0]);
      stroke(at(...left, z), at(...left, high[2]));
      g.stroke();
      const inner = at(middle[0], middle[1], z);
      const outward = (p, by) => {
        const d = [p[0] - inner[0], p[1] - inner[1]], length = Math.hypot(...d) || 1;
        return [p[0] + by * d[0] / length, p[1] + by * d[1] / length];
      };
      const say = (text, p) => labels.push({ text, at: p, colour: this.ink, fixed: true });
      for (const [v, text] of every[0]) say(text, outward(at(v, front[1], z), 14));
      for (const [v, text] of every[1]) say(text, outward(at(front[0], v, z), 14));
      for (const [v, text] of every[2]) { const p = at(...left, v); say(text, [p[0] - 16, p[1]]); }
      labels.unshift({ text: "x [m]", at: outward(at(middle[0], front[1], z), 34), colour: this.ink, fixed: true },
        { text: "y [m]", at: outward(at(front[0], middle[1], z), 34), colour: this.ink, fixed: true });
      const top = at(...left, high[2]);
      labels.unshift({ text: "z [m]", at: [top[0], top[1] - 14], colour: this.ink, fixed: true });
    },
    /* Triangles with a depth for each pixel, on a canvas of their own. */
    mesh(g, axes, one, fine) {
      // One that neither moved nor is seen from elsewhere is drawn already.
      const sight = [fine, this.yaw, this.pitch, this.scale, ...this.size, ...this.origin()].join();
      if (one.sight !== sight) this.depth = this.shaded(axes, one, fine);
      one.sight = sight;
      g.drawImage(this.body, 0, 0, ...this.size);
    },
    shaded(axes, one, fine) {
      const [w, h] = this.size.map((v) => Math.round(v * fine)), { faces: [I, J, K], seen } = one, [x, y, z] = one.at;
      if (this.body.width !== w || this.body.height !== h) [this.body.width, this.body.height] = [w, h];
      const context = this.body.getContext("2d"), image = (one.image?.width === w && one.image.height === h)
        ? one.image : (one.image = context.createImageData(w, h));
      const pixels = new Uint32Array(image.data.buffer), depth = new Float32Array(w * h).fill(Infinity);
      pixels.fill(0);
      const light = axes[2].map((v, k) => 0.75 * v + 0.55 * axes[1][k] - 0.35 * axes[0][k]);
      const normals = new Float64Array(3 * x.length), flat = one.trace.flatshading, lit = new Float64Array(x.length);
      const brightness = (n) => {
        const length = Math.hypot(...n);
        return length ? 0.5 + 0.5 * Math.abs(n[0] * light[0] + n[1] * light[1] + n[2] * light[2]) / length : 0.5;
      };
      const face = (i, j, k) => cross([x[j] - x[i], y[j] - y[i], z[j] - z[i]], [x[k] - x[i], y[k] - y[i], z[k] - z[i]]);
      if (!flat) {
        for (let t = 0; t < I.length; t++) {
          const n = face(I[t], J[t], K[t]);
          for (const corner of [I[t], J[t], K[t]]) for (let k = 0; k < 3; k++) normals[3 * corner + k] += n[k];
        }
        for (let i = 0; i < x.length; i++) lit[i] = brightness(normals.subarray(3 * i, 3 * i + 3));
      }
      const ink = [1, 3, 5].map((i) => parseInt(one.trace.color.slice(i, i + 2), 16));
      for (let t = 0; t < I.length; t++) {
        const a = 3 * I[t], b = 3 * J[t], c = 3 * K[t];
        const x0 = seen[a] * fine, y0 = seen[a + 1] * fine, x1 = seen[b] * fine, y1 = seen[b + 1] * fine, x2 = seen[c] * fine, y2 = seen[c + 1] * fine;
        const area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
        if (!(Math.abs(area) > 1e-9)) continue; // also where a joint is not read
        const even = flat ? brightness(face(I[t], J[t], K[t])) : 0;
        const [l0, l1, l2] = flat ? [even, even, even] : [lit[I[t]], lit[J[t]], lit[K[t]]];
        const bottom = Math.min(h - 1, Math.ceil(Math.max(y0, y1, y2))), right = Math.min(w - 1, Math.ceil(Math.max(x0, x1, x2)));
        for (let v = Math.max(0, Math.floor(Math.min(y0, y1, y2))); v <= bottom; v++)
          for (let u = Math.max(0, Math.floor(Math.min(x0, x1, x2))); u <= right; u++) {
            const q1 = ((u - x0) * (y2 - y0) - (x2 - x0) * (v - y0)) / area, q2 = ((x1 - x0) * (v - y0) - (u - x0) * (y1 - y0)) / area, q0 = 1 - q1 - q2;
            if (q0 < 0 || q1 < 0 || q2 < 0) continue;
            const d = q0 * seen[a + 2] + q1 * seen[b + 2] + q2 * seen[c + 2], i = v * w + u;
            if (d >= depth[i]) continue;
            depth[i] = d;
            const l = q0 * l0 + q1 * l1 + q2 * l2;
            pixels[i] = 0xff000000 | (ink[2] * l) << 16 | (ink[1] * l) << 8 | (ink[0] * l);
          }
      }
      context.putImageData(image, 0, 0);
      return { depth, w, h, fine };
    },
    /* Whether the body hides a point. */
    hidden(x, y, depth) {
      if (!this.depth) return false;
      const { fine, w, h } = this.depth, u = Math.round(x * fine), v = Math.round(y * fine);
      return u >= 0 && v >= 0 && u < w && v < h && this.depth.depth[v * w + u] < depth - 1e-3 * this.far;
    },
    lines(g, { trace, seen }) {
      g.strokeStyle = trace.line.color;
      g.lineWidth = trace.line.width > 2 ? 2 : 1;
      g.globalAlpha = trace.opacity ?? 1;
      g.beginPath();
      let drawn = false;
      for (let i = 0; i < seen.length; i += 3) {
        const whole = seen[i] - seen[i] === 0;
        if (whole) drawn ? g.lineTo(seen[i], seen[i + 1]) : g.moveTo(seen[i], seen[i + 1]);
        drawn = whole;
      }
      g.stroke();
      g.globalAlpha = 1;
    },
    /* Points; what the body hides is faint. */
    markers(g, { trace, seen, colours }) {
      const size = trace.marker.size + 1;
      if (trace.marker.opacity === 0) return;
      g.fillStyle = trace.marker.color;
      for (let i = 0; i < seen.length; i += 3) {
        if (colours) g.fillStyle = colours[i / 3];
        g.globalAlpha = (trace.marker.opacity ?? 1) * (this.hidden(seen[i], seen[i + 1], seen[i + 2]) ? 0.35 : 1);
        if (this.moving) g.fillRect(seen[i] - size / 2, seen[i + 1] - size / 2, size, size);
        else { g.beginPath(); g.arc(seen[i], seen[i + 1], size / 2, 0, 2 * Math.PI); g.fill(); }
      }
      g.globalAlpha = 1;
    },
    /* Around the selected poses, and the one that is pointed at. */
    rings(g) {
      const { trace: { customdata }, seen } = this.poses ?? { trace: {} };
      customdata?.forEach((position, i) => {
        const here = position === this.pointed;
        if (!here && !this.chosen.has(position)) return;
        g.beginPath();
        g.arc(seen[3 * i], seen[3 * i + 1], here ? 8 : 5, 0, 2 * Math.PI);
        g.strokeStyle = "#d55e00";
        g.lineWidth = here ? 3 : 2;
        g.stroke();
      });
    },
    named({ trace, seen }, labels) {
      const stated = trace.textfont?.color ?? trace.marker?.color;
      const colour = !stated ? this.ink : this.dark ? `color-mix(in srgb, ${stated} 45%, white)` : stated;
      trace.text.forEach((text, i) => {
        if (text && seen[3 * i] === seen[3 * i]) labels.push({ text: plain(text), at: [seen[3 * i], seen[3 * i + 1]], colour });
      });
    },
    /* Labels above all else, none over another: beside their place where that is taken. */
    write(g, labels) {
      const taken = [];
      g.textAlign = "center";
      g.textBaseline = "middle";
      g.lineJoin = "round";
      g.strokeStyle = this.paper;
      for (const { text, at: [x, y], colour, fixed } of labels) {
        const half = g.measureText(text).width / 2 + 2;
        const places = fixed ? [[x, y]] : [[x, y - 13], [x, y + 13], [x + half + 8, y], [x - half - 8, y], [x, y - 28], [x, y + 28]];
        const [u, v] = places.find(([a, b]) => taken.every(([c, d, e]) => Math.abs(a - c) > half + e || Math.abs(b - d) > 14)) ?? [];
        if (u === undefined) continue;
        taken.push([u, v, half]);
        g.lineWidth = 3;
        g.strokeText(text, u, v);
        g.fillStyle = colour;
        g.fillText(text, u, v);
      }
      g.textBaseline = "alphabetic";
    },
    colourbar(g) {
      const { colorbar } = this.bar.trace.marker, [cmin, cmax] = this.bar.ends, [w, h] = this.size, top = this.narrow() ? 64 : 40, high = h - top - 40, x = w - (this.narrow() ? 42 : 54);
      for (let i = 0; i < high; i += 4) { g.fillStyle = shade(1 - i / high); g.fillRect(x, top + i, 10, 4); }
      g.fillStyle = this.ink;
      g.textAlign = "left";
      g.textBaseline = "middle";
      for (const [v, text] of ticks(cmin, cmax, 5)) {
        const wide = g.measureText(text).width > w - x - 14; // at the edge a number would lose its last digits
        g.fillText(wide ? Number(v.toPrecision(2)).toExponential().replace("e+", "e") : text, x + 14, top + high * (1 - (v - cmin) / (cmax - cmin)));
      }
      g.textBaseline = "alphabetic";
      g.fillText(colorbar.title.text, x - 4, top - 14);
    },
    /* The selection of the page (linked.js), and the pose that is pointed at in another figure. */
    mark(positions) { this.chosen = new Set(positions); this.redraw(); },
    point(position) { if (position !== this.pointed) { this.pointed = position; this.redraw(); } },
    nearer(times) { this.zoom = Math.min(Math.max(this.zoom * times, 0.2), 30); this.redraw(); },
    turn(right, up) {
      this.yaw -= right;
      this.pitch = Math.min(Math.max(this.pitch + up, -1.5), 1.5);
      this.redraw();
    },
    key(event) {
      const turns = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
      if (turns[event.key]) this.turn(...turns[event.key]);
      else if (event.key === "+" || event.key === "-") this.nearer(event.key === "+" ? 1.2 : 1 / 1.2);
      else if (event.key === "Home") { Object.assign(this, { yaw: 0.8, pitch: 0.42, zoom: 1, shift: [0, 0] }); this.fit(); }
      else return;
      event.preventDefault();
    },
    local(event) {
      const box = this.$el.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    },
    down(event) {
      this.$el.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, this.local(event));
      this.begun = { at: this.local(event), frame: linked.frames && this.poses };
      this.tip.style.display = "none";
    },
    move(event) {
      const now = this.local(event), before = this.pointers.get(event.pointerId);
      if (!before) return this.hover(now);
      const by = [now[0] - before[0], now[1] - before[1]];
      this.pointers.set(event.pointerId, now);
      if (this.begun.frame) return this.framed(now);
      this.moving ||= Math.hypot(now[0] - this.begun.at[0], now[1] - this.begun.at[1]) > 3;
      if (!this.moving) return;
      if (this.pointers.size === 2) {
        const [, other] = [...this.pointers].find(([id]) => id !== event.pointerId);
        const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
        this.nearer(apart(now) / apart(before));
      } else if (event.buttons & 2 || event.ctrlKey) this.shift = this.shift.map((v, k) => v + by[k]);
      else this.turn(0.008 * by[0], 0.008 * by[1]);
      this.redraw();
    },
    up(event) {
      if (!this.pointers.delete(event.pointerId)) return;
      const now = this.local(event);
      if (this.begun.frame && this.frame.style.display === "block") this.select(this.begun.at, now);
      else if (!this.moving && this.poses) {
        const near = this.nearest(now);
        if (near !== null) this.$emit("plotly_click", { points: [{ customdata: this.poses.trace.customdata[near] }] });
      }
      this.moving = false;
      this.redraw();
    },
    cancel(event) { this.pointers.delete(event.pointerId); this.moving = false; this.frame.style.display = "none"; this.redraw(); },
    leave() { this.tip.style.display = "none"; this.tell(null); },
    /* The trace and number of the point under a place; of the poses alone their number. */
    nearest(place, one = this.poses) {
      let near = null, least = NEAR;
      for (let i = 0; i < one.seen.length; i += 3) {
        const away = Math.hypot(one.seen[i] - place[0], one.seen[i + 1] - place[1]);
        if (away < least) [near, least] = [i / 3, away];
      }
      return near;
    },
    hover(place) {
      const one = this.traces.find((each) => each.seen && each.trace.hoverinfo === "text" && this.nearest(place, each) !== null);
      const near = one ? this.nearest(place, one) : null, text = one?.trace.text[near];
      Object.assign(this.tip.style, { display: text ? "block" : "none", left: `${place[0] + 12}px`, top: `${place[1] + 12}px` });
      if (text) this.tip.textContent = plain(text);
      this.tell(one && one === this.poses ? one.trace.customdata[near] : null);
    },
    tell(position) {
      if (position === this.pointed || !this.poses) return;
      this.pointed = position;
      this.redraw();
      if (position === null) this.$emit("plotly_unhover", {});
      else this.$emit("plotly_hover", { points: [{ customdata: position }] });
    },
    framed(now) {
      const { at } = this.begun, [x, y] = [0, 1].map((k) => [at[k], now[k]].sort((a, b) => a - b));
      Object.assign(this.frame.style, { display: "block", left: `${x[0]}px`, top: `${y[0]}px`, width: `${x[1] - x[0]}px`, height: `${y[1] - y[0]}px` });
    },
    /* Select the poses that are seen in a frame. */
    select(begin, end) {
      this.frame.style.display = "none";
      const [x, y] = [0, 1].map((k) => [begin[k], end[k]].sort((a, b) => a - b)), { seen, trace } = this.poses;
      const inside = trace.customdata.flatMap((customdata, i) =>
        x[0] <= seen[3 * i] && seen[3 * i] <= x[1] && y[0] <= seen[3 * i + 1] && seen[3 * i + 1] <= y[1] ? [{ customdata }] : []);
      const [w, h] = this.size, range = { x: x.map((v) => 2 * v / w - 1), y: y.map((v) => 1 - 2 * v / h).reverse(), matrix: this.matrix() };
      if (inside.length) this.$emit("plotly_selected", { points: inside, range });
      else this.$emit("plotly_deselect", {});
    },
  },
};

/* Texts come as plotly reads them. */
const parser = document.createElement("textarea");
function plain(text) {
  parser.innerHTML = text.replace(/<br>/g, ", ");
  return parser.value;
}
