// The plots of a report page: decodes the embedded series, draws them with uPlot, keeps plots of one axis together.
(() => {
  "use strict";

  const data = JSON.parse(document.getElementById("rths-data").textContent);
  const PRINTED_PX = 680; // width of a plot on paper
  const WIDE = new Set(["sim", "desired", "response"]); // drawn broad and below, so that what follows them stays visible
  const groups = [];

  // ---- data ----------------------------------------------------------------------------------------------------------

  function bytes(text) {
    return Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0)).buffer;
  }

  function floats(text) {
    return Array.from(new Float32Array(bytes(text)));
  }

  // A series holds the samples that its envelope needs: steps between their places, and values (see envelope.py).
  function decode(series) {
    const Steps = { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[series.w];
    const steps = new Steps(bytes(series.i));
    const values = series.k ? new Int16Array(bytes(series.y)) : new Float32Array(bytes(series.y));
    const x = new Array(steps.length);
    const y = new Array(steps.length);
    let place = 0;
    for (let i = 0; i < steps.length; i++) {
      place += steps[i];
      x[i] = series.t0 + place * series.dt;
      y[i] = series.k ? (values[i] === -32768 ? null : values[i] * series.k) : finite(values[i]);
    }
    return [x, y];
  }

  function finite(value) {
    return Number.isFinite(value) ? value : null;
  }

  // ---- a plot --------------------------------------------------------------------------------------------------------

  function colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  }

  function shown(value) {
    return value == null ? "-" : Number(value.toPrecision(4)).toString();
  }

  function make(name, text, parent, kind) {
    const made = document.createElement(name);
    if (text) made.textContent = text;
    if (kind) made.className = kind;
    if (parent) parent.append(made);
    return made;
  }

  function axis(more) {
    const line = () => ({ stroke: () => colour("line"), width: 1 });
    const values = (_, splits) => splits.map((value) => (value == null ? "" : Number(value.toPrecision(7)).toString()));
    return { stroke: () => colour("ink"), values, font: "12px system-ui, sans-serif", grid: line(), ticks: line(), ...more };
  }

  // Of a logarithmic axis, the lines at powers of ten.
  function decades() {
    const filter = (_, splits) => splits.map((value) => (Math.abs(Math.log10(value) % 1) < 1e-6 ? value : null));
    return { stroke: () => colour("line"), width: 1, filter };
  }

  // One that was cut ran away before: it would leave no room for the others, so that it waits for a click.
  function trace(one) {
    const cut = one.whole === false;
    return {
      label: cut ? `${one.name} (cut: click to show)` : one.name,
      show: !cut,
      stroke: () => colour(one.role),
      width: WIDE.has(one.role) ? 3 : 1.2,
      points: { show: false },
      value: (_, value) => shown(value),
    };
  }

  // Traces have samples at different instants: the cursor tells each by its own nearest one, if it is near.
  function nearest(plot, series, index) {
    const values = plot.data[series];
    for (let away = 0; away < 40; away++) {
      if (values[index - away] != null) return index - away;
      if (values[index + away] != null) return index + away;
    }
    return index;
  }

  // `shape`: title, unit, traces [{name, role}], columns [x, y, ...], logY
  function draw(group, parent, shape) {
    const frame = make("div", "", parent, "plot");
    make("h4", `${shape.title} (${shape.unit})`, frame);
    if (!shape.traces.length) {
      make("p", "nothing to show: not run, or cut before its end", frame, "empty");
      return;
    }
    const options = {
      width: frame.clientWidth,
      height: shape.height || 210,
      padding: [10, 12, 0, 0],
      scales: {
        x: { time: false, distr: group.log ? 3 : 1, range: (_, from, to) => [from, to] },
        y: { distr: shape.logY ? 3 : 1 },
      },
      axes: [axis({ space: 50, size: 30 }), axis(shape.logY ? { size: 64, grid: decades(), ticks: decades() } : { size: 64 })],
      series: [{ label: group.label, value: (_, value) => shown(value) }, ...shape.traces.map(trace)],
      cursor: {
        sync: { key: group.label },
        dataIdx: nearest,
        drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => group.show(...group.whole) },
      },
      hooks: { setSelect: [(plot) => group.select(plot)] },
    };
    const plot = new uPlot(options, shape.columns, frame);
    frame.setAttribute("role", "img");
    frame.setAttribute("aria-label", `${shape.title} in ${shape.unit}`);
    group.plots.push(plot);
    listen(plot, group);
  }

  // ---- plots of one axis: zoomed and moved together ------------------------------------------------------------------

  class Group {
    constructor(label, parent, log) {
      Object.assign(this, { label, log, plots: [], whole: [0, 1], view: [0, 1], least: 1e-3 });
      this.zoom = make("div", "", parent, "zoom");
      this.parent = make("div", "", parent);
      const buttons = [
        ["whole", "show all", () => this.show(...this.whole)],
        ["+", "zoom in", () => this.scale(0.5)],
        ["\u2212", "zoom out", () => this.scale(2)],
        ["\u25c0", "move back", () => this.move(-0.25)],
        ["\u25b6", "move on", () => this.move(0.25)],
      ];
      for (const [text, title, act] of buttons) {
        const button = make("button", text, this.zoom);
        button.type = "button";
        button.title = title;
        button.setAttribute("aria-label", title);
        button.addEventListener("click", act);
      }
      this.told = make("output", "", this.zoom);
      groups.push(this);
    }

    clear(from, to, least) {
      for (const plot of this.plots) plot.destroy();
      this.parent.replaceChildren();
      this.zoom.hidden = !(to > from);
      Object.assign(this, { plots: [], whole: [from, to], view: [from, to], least });
    }

    // A logarithmic axis is zoomed by its logarithm.
    on(value) {
      return this.log ? Math.log(value) : value;
    }

    off(value) {
      return this.log ? Math.exp(value) : value;
    }

    show(from, to) {
      const [first, last] = this.whole.map((value) => this.on(value));
      const span = Math.min(Math.max(this.on(to) - this.on(from), this.least), last - first);
      const start = Math.min(Math.max(this.on(from), first), last - span);
      this.view = span < last - first ? [this.off(start), this.off(start + span)] : [...this.whole];
      for (const plot of this.plots) plot.setScale("x", { min: this.view[0], max: this.view[1] });
      this.told.textContent = `${shown(this.view[0])} to ${shown(this.view[1])} ${this.log ? "Hz" : "s"}`;
    }

    scale(factor, about) {
      const [from, to] = this.view.map((value) => this.on(value));
      const centre = about === undefined ? (from + to) / 2 : this.on(about);
      this.show(this.off(centre - (centre - from) * factor), this.off(centre + (to - centre) * factor));
    }

    move(share) {
      const [from, to] = this.view.map((value) => this.on(value));
      this.show(this.off(from + share * (to - from)), this.off(to + share * (to - from)));
    }

    select(plot) {
      const { left, width } = plot.select;
      if (width < 4) return;
      plot.setSelect({ left: 0, width: 0 }, false);
      this.show(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
    }
  }

  // Moves by a finger or with shift, zooms by two fingers or the wheel with ctrl; the page itself scrolls as ever.
  function listen(plot, group) {
    const over = plot.over;
    const down = new Map();
    const spread = () => {
      const [a, b] = [...down.values()];
      return Math.max(Math.abs(a - b), 10);
    };
    over.addEventListener("mousedown", (event) => event.shiftKey && event.stopImmediatePropagation(), true);
    over.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "mouse" && !(event.shiftKey && event.button === 0)) return;
      down.set(event.pointerId, event.clientX);
      over.setPointerCapture(event.pointerId);
    });
    over.addEventListener("pointermove", (event) => {
      if (!down.has(event.pointerId)) return;
      const before = down.size === 2 ? spread() : down.get(event.pointerId);
      down.set(event.pointerId, event.clientX);
      if (down.size === 2) group.scale(before / spread());
      else group.move((before - event.clientX) / over.clientWidth);
    });
    for (const name of ["pointerup", "pointercancel"]) over.addEventListener(name, (event) => down.delete(event.pointerId));
    over.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey) return;
        event.preventDefault();
        const at = plot.posToVal(event.clientX - over.getBoundingClientRect().left, "x");
        group.scale(event.deltaY > 0 ? 1.25 : 0.8, at);
      },
      { passive: false },
    );
  }

  // ---- the choices ---------------------------------------------------------------------------------------------------

  function choice(label, names, act) {
    const box = make("label", label, document.getElementById("controls"));
    const select = make("select", "", box);
    select.addEventListener("change", act);
    fill(select, names);
    return select;
  }

  function fill(select, names) {
    const before = select.options[select.selectedIndex]?.textContent;
    select.replaceChildren(...names.map((name) => new Option(name)));
    select.selectedIndex = names.length ? Math.max(names.indexOf(before), 0) : -1;
    select.parentElement.hidden = names.length < 2;
  }

  function chart(group, one) {
    const tables = one.traces.map((item) => decode(data.series[item.series]));
    const columns = tables.length > 1 ? uPlot.join(tables) : tables[0];
    draw(group, group.parent, { ...one, columns });
  }

  function showResult() {
    const result = data.results[which.selectedIndex];
    fill(run, result.runs.map((view) => view.name));
    fill(storey, result.storeys.map((view) => view.name));
    remark.textContent = `${result.name}, ${result.remark}`;
    showTime();
    showResponse(result);
  }

  function showTime() {
    const result = data.results[which.selectedIndex];
    const views = [result.runs[run.selectedIndex], result.storeys[storey.selectedIndex]].filter(Boolean);
    const charts = views.flatMap((view) => view.charts);
    const used = charts.flatMap((one) => one.traces).map((one) => data.series[one.series]);
    const from = Math.min(...used.map((one) => one.t0));
    const to = Math.max(...used.map((one) => one.t0 + (one.n - 1) * one.dt));
    const same = time.whole[0] === from && time.whole[1] === to;
    const view = time.view;
    time.clear(from, to, 10 * Math.max(...used.map((one) => one.dt)));
    for (const one of charts) chart(time, one);
    if (used.length) time.show(...(same ? view : time.whole));
    if (!charts.length) make("p", "This result holds no time histories.", time.parent, "empty");
  }

  function showResponse(result) {
    const found = data.responses[result.response];
    frequency.clear(0, 0, 0.02);
    document.getElementById("frequency-plots").parentElement.hidden = !found;
    if (!found) return;
    const of = Object.fromEntries(Object.entries(found).map(([name, text]) => [name, floats(text).map(finite)]));
    const hz = of.frequency;
    const measured = { name: "measured", role: "response" };
    const coherence = [{ name: "measured", role: "measured" }];
    const two = [measured, { name: "model", role: "model" }];
    frequency.clear(hz[0], hz[hz.length - 1], 0.02);
    const plots = [
      { title: "Magnitude", unit: "m/s\u00b2/V", traces: two, columns: [hz, of.measured, of.modelled], logY: true },
      { title: "Phase", unit: "degrees", traces: two, columns: [hz, of.phase, of.modelled_phase], height: 170 },
      { title: "Coherence", unit: "1", traces: coherence, columns: [hz, of.coherence], height: 140 },
    ];
    for (const one of plots) draw(frequency, frequency.parent, one);
    frequency.show(...frequency.whole);
  }

  // ---- the page ------------------------------------------------------------------------------------------------------

  function resize(width) {
    for (const group of groups)
      for (const plot of group.plots)
        plot.setSize({ width: width || plot.root.parentElement.clientWidth, height: plot.height });
  }

  function redraw() {
    for (const group of groups) for (const plot of group.plots) plot.redraw(false);
  }

  function printing(on) {
    document.documentElement.classList.toggle("printing", on);
    resize(on ? PRINTED_PX : 0);
    redraw();
  }

  async function copy(button) {
    const code = document.getElementById(button.dataset.copy);
    try {
      await navigator.clipboard.writeText(code.textContent);
    } catch {
      getSelection().selectAllChildren(code); // where a page may not write to the clipboard
      document.execCommand("copy");
    }
    button.textContent = "copied";
    setTimeout(() => (button.textContent = "copy"), 1500);
  }

  const which = choice("Result", data.results.map((result) => result.name), showResult);
  const run = choice("Table in", [], showTime);
  const storey = choice("Storey", [], showTime);
  const plots = document.getElementById("time-plots");
  const remark = make("p", "", plots, "remark");
  const time = new Group("t (s)", plots, false);
  const frequency = new Group("f (Hz)", document.getElementById("frequency-plots"), true);
  showResult();

  // In the next frame: a size changed within the observer's own turn is a fault on the console of a narrow window.
  new ResizeObserver(() => requestAnimationFrame(() => resize(0))).observe(plots);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addEventListener("beforeprint", () => printing(true));
  addEventListener("afterprint", () => printing(false));
  for (const button of document.querySelectorAll("button.copy")) button.addEventListener("click", () => copy(button));
})();
