// The plots of a report page: decodes the embedded series, draws them with uPlot, keeps plots of one axis together.
(() => {
  "use strict";

  const data = JSON.parse(document.getElementById("rths-data").textContent);
  const PRINTED_PX = 680; // width of a plot on paper
  const BESIDE_SKETCH_PX = 480; // of one beside the sketch there
  const PRINTED_SHARE = 0.8; // of its height on the screen
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

  // The title of an axis: its quantity and unit.
  function titled(label) {
    return { label, labelSize: 18, labelGap: 0, labelFont: "12px system-ui, sans-serif" };
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

  // One that was cut ran away before, and SIM-DELAY's error is large: what leaves no room for others waits for a click.
  function trace(one) {
    const waits = one.whole === false ? " (cut: click to show)" : " (click to show)";
    return {
      label: one.shown === false ? one.name + waits : one.name,
      show: one.shown !== false,
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
    make("h4", shape.title, frame);
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
      axes: [
        axis({ space: 50, size: 28, ...titled(group.title) }),
        axis({ size: 56, space: 20, ...titled(shape.unit), ...(shape.logY ? { grid: decades(), ticks: decades() } : {}) }),
      ],
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
    frame.setAttribute("aria-label", `${shape.title}, ${shape.unit}`);
    plot.screenHeight = options.height;
    group.plots.push(plot);
    listen(plot, group);
  }

  // ---- plots of one axis: zoomed and moved together ------------------------------------------------------------------

  class Group {
    constructor(label, title, parent, log) {
      Object.assign(this, { label, title, log, plots: [], whole: [0, 1], view: [0, 1], least: 1e-3, linked: [this] });
      this.printedPx = PRINTED_PX;
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
      const view = span < last - first ? [this.off(start), this.off(start + span)] : [...this.whole];
      for (const group of this.linked) group.apply(view);
    }

    apply(view) {
      this.view = view;
      for (const plot of this.plots) plot.setScale("x", { min: view[0], max: view[1] });
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

  function choice(label, parent, names, act) {
    const box = make("label", label, document.getElementById(parent));
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
    for (const part of document.querySelectorAll("[data-result]"))
      part.hidden = part.dataset.result !== String(which.selectedIndex);
    fill(run, result.runs.map((view) => view.name));
    fill(storey, result.storeys.map((view) => view.name));
    remark.textContent = `${result.name}, ${result.remark}`;
    showTime();
    showResponse(result);
  }

  function showTime() {
    const result = data.results[which.selectedIndex];
    const ofStorey = result.storeys[storey.selectedIndex]?.charts ?? [];
    const ofTable = result.runs[run.selectedIndex]?.charts ?? [];
    const ground = result.record ? [{ ...result.record, height: 130 }] : [];
    const ofBuilding = [...ground, ...ofStorey.map((one, place) => ({ ...one, height: place ? 160 : 210 }))];
    const used = [...ofBuilding, ...ofTable].flatMap((one) => one.traces).map((one) => data.series[one.series]);
    const from = Math.min(...used.map((one) => one.t0));
    const to = Math.max(...used.map((one) => one.t0 + (one.n - 1) * one.dt));
    const same = time.whole[0] === from && time.whole[1] === to;
    const view = time.view;
    for (const group of time.linked) group.clear(from, to, 10 * Math.max(...used.map((one) => one.dt)));
    for (const one of ofBuilding) chart(building, one);
    for (const one of ofTable) chart(time, one);
    if (used.length) time.show(...(same ? view : time.whole));
    if (!ofBuilding.length) make("p", "This result holds no response of a building.", building.parent, "empty");
    if (!ofTable.length) make("p", "This result holds no motion of a table.", time.parent, "empty");
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
      { title: "Coherence", unit: "coherence", traces: coherence, columns: [hz, of.coherence], height: 150 },
    ];
    for (const one of plots) draw(frequency, frequency.parent, one);
    frequency.show(...frequency.whole);
  }

  // ---- the page ------------------------------------------------------------------------------------------------------

  function resize() {
    const printed = document.documentElement.classList.contains("printing");
    for (const group of groups)
      for (const plot of group.plots)
        plot.setSize({
          width: printed ? group.printedPx : plot.root.parentElement.clientWidth,
          height: printed ? PRINTED_SHARE * plot.screenHeight : plot.screenHeight,
        });
  }

  function redraw() {
    for (const group of groups) for (const plot of group.plots) plot.redraw(false);
  }

  function printing(on) {
    document.documentElement.classList.toggle("printing", on);
    resize();
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

  const which = choice("Result", "controls", data.results.map((result) => result.name), showResult);
  const storey = choice("Storey", "controls", [], showTime);
  const run = choice("Table in", "table-controls", [], showTime);
  const plots = document.getElementById("time-plots");
  const building = new Group("t (s)", "time (s)", document.getElementById("response-plots"), false);
  const remark = make("p", "", plots, "remark");
  const time = new Group("t (s)", "time (s)", plots, false);
  building.printedPx = BESIDE_SKETCH_PX;
  building.linked = time.linked = [building, time];
  const frequency = new Group("f (Hz)", "frequency (Hz)", document.getElementById("frequency-plots"), true);
  showResult();

  // In the next frame: a size changed within the observer's own turn is a fault on the console of a narrow window.
  const fitted = new ResizeObserver(() => requestAnimationFrame(() => resize()));
  for (const watched of [plots, building.parent]) fitted.observe(watched);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addEventListener("beforeprint", () => printing(true));
  addEventListener("afterprint", () => printing(false));
  for (const button of document.querySelectorAll("button.copy")) button.addEventListener("click", () => copy(button));
})();
