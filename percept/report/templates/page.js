"use strict";
(() => {
  const $ = (selector, from = document) => from.querySelector(selector);
  const all = (selector, from = document) => [...from.querySelectorAll(selector)];
  const METHODS = { classical: "classical", bayesian: "Bayesian" };
  const KINDS = { mean: "average user", user: "next user", share: "share of users" };

  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (key in made && typeof value !== "string") made[key] = value;
      else made.setAttribute(key, value);
    }
    made.append(...children);
    return made;
  }

  // Light and dark: the reader's choice stands above the system's, for this page only.
  function themes() {
    const root = document.documentElement;
    const button = $("#theme");
    const system = matchMedia("(prefers-color-scheme: dark)");
    const dark = () => (root.dataset.theme ?? (system.matches ? "dark" : "light")) === "dark";
    const name = () => { button.textContent = dark() ? "Light mode" : "Dark mode"; };
    button.addEventListener("click", () => { root.dataset.theme = dark() ? "light" : "dark"; name(); });
    system.addEventListener("change", name);
    button.hidden = false;
    name();
  }

  // Every digit of a number, where the pointer rests.
  function digits() {
    for (const shown of all("data[value]")) shown.title = shown.value;
  }

  // Sort a table by a column; a third click brings the first order back.
  function sorting() {
    for (const table of all("table.sortable")) {
      const body = table.tBodies[0];
      const first = [...body.rows];
      const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
      heads.forEach((head, column) => {
        const button = element("button", { type: "button", class: "sort" }, ...head.childNodes);
        head.replaceChildren(button);
        button.addEventListener("click", () => {
          const next = { none: "ascending", ascending: "descending", descending: "none" }[
            head.getAttribute("aria-sort") ?? "none"];
          heads.forEach((other) => other.removeAttribute("aria-sort"));
          if (next !== "none") head.setAttribute("aria-sort", next);
          table.classList.toggle("sorted", next !== "none");
          const rows = [...first];
          if (next !== "none") rows.sort((a, b) => order(value(a, column), value(b, column)));
          if (next === "descending") rows.reverse();
          body.append(...rows);
        });
      });
    }
    function value(row, column) {
      const cell = row.cells[column];
      const exact = cell && $("data", cell);
      if (!exact) return cell ? cell.textContent : "";
      return { inf: Infinity, "-inf": -Infinity }[exact.value] ?? Number(exact.value);
    }
    function order(a, b) {
      if (typeof a === "number" && typeof b === "number") return a - b;
      return String(a).localeCompare(String(b), undefined, { numeric: true });
    }
  }

  function copying() {
    if (!navigator.clipboard) return;
    for (const text of all("blockquote.paste")) {
      const button = element("button", { type: "button", class: "tool" }, "Copy");
      button.addEventListener("click", async () => {
        await navigator.clipboard.writeText(text.innerText.trim());
        button.textContent = "Copied";
      });
      text.closest("section").querySelector("h3").append(" ", button);
    }
  }

  // The explorer: every environment over one window of ω, zoomed together.
  function explorer() {
    const place = $("#explorer");
    const source = $("#curves");
    if (!place || !source) return;
    const data = prepared(JSON.parse(source.textContent));
    if (!data.length) return;
    const range = [data[0].omega[0], data[0].omega.at(-1)];
    const state = { window: [...range], at: null };
    const options = (name) => [...new Set(data.flatMap((one) => one.limits.map((limit) => limit[name])))];
    const select = (label, name, values, labels = {}) => {
      const box = element("select", { name }, ...values.map((value) =>
        element("option", { value }, labels[value] ?? value)));
      return [element("label", {}, `${label} `, box), box];
    };
    const kinds = options("kind");
    const [kindLabel, kind] = select("Kind", "kind", kinds, KINDS);
    const shapes = options("shape");
    const [shapeLabel, shape] = select("Shape", "shape", shapes);
    if (shapes.includes("envelope")) shape.value = "envelope";
    const families = options("family");
    const [familyLabel, family] = select("Family", "family", families);
    const bayesian = data.flatMap((one) => one.limits).find((limit) => limit.method === "bayesian");
    if (bayesian) family.value = bayesian.family;
    const [scaleLabel, scale] = select("Scale", "scale", ["ratio", "absolute"],
      { ratio: "over the reference", absolute: "|Z_h| in N·s/m" });
    const edge = (label, index) => {
      const box = element("input", { type: "number", step: "any", min: String(range[0]), max: String(range[1]) });
      box.addEventListener("change", () => {
        const window = [...state.window];
        window[index] = Math.min(Math.max(Number(box.value), range[0]), range[1]);
        if (window[0] < window[1]) zoom(window);
        else box.value = state.window[index];
      });
      return [element("label", {}, `${label} `, box, " rad/s"), box];
    };
    const [fromLabel, from] = edge("ω from", 0);
    const [toLabel, to] = edge("to", 1);
    const whole = element("button", { type: "button", class: "tool" }, "Whole range");
    whole.addEventListener("click", () => zoom([...range]));
    const form = element("form", { class: "controls", "aria-label": "Window and curves of the plots" },
      kindLabel, shapeLabel, familyLabel, scaleLabel, fromLabel, toLabel, whole);
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("change", () => draw());
    const plots = data.map((one) => plot(one));
    place.append(
      element("p", {}, "Drag across a plot to zoom all, double-click for the whole range. Keys: arrows read, "
        + "plus and minus zoom, Escape goes back."),
      form, element("p", { class: "legend" },
        ...[["classical", "classical limits"], ["bayesian", "Bayesian limits"], ["ink", "the reference"],
          ...(data.some((one) => one.coupled) ? [["coupled", "the reference through the coupling"]] : [])]
          .map(([css, text]) => element("span", { style: `--line: var(--${css})` }, text))),
      element("div", { class: "plots" }, ...plots.map((one) => one.box)));
    place.hidden = false;
    draw();

    function zoom(window) {
      Object.assign(state, { window, at: null });
      draw();
    }

    function draw() {
      from.value = Number(state.window[0].toPrecision(6));
      to.value = Number(state.window[1].toPrecision(6));
      for (const one of plots) one.draw();
    }

    function read() {
      for (const one of plots) one.read();
    }

    function plot(one) {
      const W = 300, H = 230, L = 50, R = 14, T = 8, B = 36;
      const svg = vector("svg", { viewBox: `0 0 ${W} ${H}`, tabindex: 0, role: "img",
        "aria-label": `${one.name}: boundary over ω; values below` });
      const output = element("output", { class: "reading" });
      const box = element("figure", {}, element("figcaption", {}, element("strong", {}, one.name)), svg, output);
      let current = null;

      function shown() {
        const window = state.window;
        const wide = window[1] / window[0] > 3;
        const grid = Array.from({ length: 160 }, (_, i) => wide
          ? window[0] * (window[1] / window[0]) ** (i / 159) : window[0] + (window[1] - window[0]) * i / 159);
        const relative = scale.value === "ratio";
        const limits = one.limits.filter((limit) => limit.kind === kind.value && limit.shape === shape.value && limit.family === family.value);
        limits.sort((a, b) => a.method.localeCompare(b.method));
        const series = limits.map((limit) => ({ name: METHODS[limit.method], css: limit.method,
          lower: grid.map((w) => interpolated(limit.lower, limit.omega, w)),
          upper: grid.map((w) => interpolated(limit.upper, limit.omega, w)) }));
        const lines = [{ name: "reference", css: "ink", values: grid.map((w) => interpolated(one.reference, one.omega, w)) }];
        if (one.coupled) {
          lines.push({ name: "with coupling", css: "coupled", values: grid.map((w) => interpolated(one.coupled, one.omega, w)) });
        }
        if (relative) {
          const base = lines[0].values;
          const divide = (values) => values.map((v, i) => v / base[i]);
          for (const s of series) { s.lower = divide(s.lower); s.upper = divide(s.upper); }
          for (const line of lines.slice().reverse()) line.values = divide(line.values);
        }
        return { window, wide, grid, series, lines, relative };
      }

      function render() {
        current = shown();
        const values = [...current.lines.map((line) => line.values),
          ...current.series.flatMap((s) => [s.lower, s.upper])].flat().filter((v) => Number.isFinite(v) && v > 0);
        let low = Math.min(...values), high = Math.max(...values);
        const tall = high / low > 6;
        const pad = tall ? (high / low) ** 0.05 : (high - low || high * 0.01) * 0.06;
        [low, high] = tall ? [low / pad, high * pad] : [low - pad, high + pad];
        const across = (w) => L + (W - L - R) * (current.wide
          ? Math.log(w / current.window[0]) / Math.log(current.window[1] / current.window[0])
          : (w - current.window[0]) / (current.window[1] - current.window[0]));
        const up = (v) => {
          const share = tall ? Math.log(Math.max(v, low) / low) / Math.log(high / low) : (v - low) / (high - low);
          return H - B - (H - B - T) * Math.min(Math.max(share, -0.02), 1.02);
        };
        Object.assign(current, { across, up });
        const path = (values) => values.map((v, i) => `${i ? "L" : "M"}${across(current.grid[i]).toFixed(1)} `
          + up(Number.isFinite(v) ? v : high * 2).toFixed(1)).join("");
        svg.replaceChildren();
        for (const tick of ticks(...current.window, current.wide)) {
          svg.append(vector("path", { class: "rule", d: `M${across(tick)} ${T}V${H - B}` }),
            label(across(tick), H - B + 12, tick, "middle"));
        }
        for (const tick of ticks(low, high, tall)) {
          svg.append(vector("path", { class: "rule", d: `M${L} ${up(tick)}H${W - R}` }),
            label(L - 4, up(tick) + 3, tick, "end"));
        }
        svg.append(vector("text", { x: (L + W - R) / 2, y: H - 4, "text-anchor": "middle" }, "ω (rad/s)"));
        for (const s of current.series) {
          const back = current.grid.map((w, i) => [w, s.lower[i]]).reverse()
            .map(([w, v]) => `L${across(w).toFixed(1)} ${up(v).toFixed(1)}`).join("");
          if (s.css === "bayesian") {
            svg.append(vector("path", { class: "area", fill: `var(--${s.css})`, d: `${path(s.upper)}${back}Z` }));
          }
          for (const side of [s.lower, s.upper]) {
            svg.append(vector("path", { class: "line", stroke: `var(--${s.css})`, d: path(side) }));
          }
        }
        for (const line of current.lines) {
          svg.append(vector("path", { class: "line", stroke: `var(--${line.css})`,
            "stroke-dasharray": line.css === "ink" ? "7 3" : "2.5 2", d: path(line.values) }));
        }
        svg.append(vector("path", { class: "cross", d: "" }), vector("rect", { class: "span", y: T, height: H - B - T }));
        reading();
      }

      function reading() {
        const { grid, across, series, lines, window } = current;
        const inside = state.at !== null && state.at >= window[0] && state.at <= window[1];
        const w = inside ? state.at : Math.sqrt(window[0] * window[1]);
        $(".cross", svg).setAttribute("d", `M${across(w)} ${T}V${H - B}`);
        const index = grid.reduce((best, g, i) => (Math.abs(g - w) < Math.abs(grid[best] - w) ? i : best), 0);
        output.replaceChildren(`ω ${brief(grid[index])} rad/s`,
          ...lines.map((line) => ` · ${line.name} ${brief(line.values[index])}`),
          ...series.map((s) => ` · ${s.name} ${brief(s.lower[index])} to ${brief(s.upper[index])}`));
      }

      const frequency = (event) => {
        const frame = svg.getBoundingClientRect();
        const share = ((event.clientX - frame.left) / frame.width * W - L) / (W - L - R);
        return between(Math.min(Math.max(share, 0), 1));
      };
      const between = (share) => {
        const [a, b] = current.window;
        return current.wide ? a * (b / a) ** share : a + (b - a) * share;
      };
      let start = null;
      svg.addEventListener("pointerdown", (event) => { if (event.button === 0) start = frequency(event); });
      svg.addEventListener("pointermove", (event) => {
        state.at = frequency(event);
        if (start !== null) {
          const ends = [start, state.at].map(current.across).sort((a, b) => a - b);
          $(".span", svg).setAttribute("x", ends[0]);
          $(".span", svg).setAttribute("width", ends[1] - ends[0]);
        }
        read();
      });
      svg.addEventListener("pointerup", (event) => {
        if (start === null) return;
        const ends = [start, frequency(event)].sort((a, b) => a - b);
        start = null;
        $(".span", svg).setAttribute("width", 0);
        if (current.across(ends[1]) - current.across(ends[0]) > 4) zoom(ends);
      });
      svg.addEventListener("pointerleave", () => { start = null; $(".span", svg).setAttribute("width", 0); });
      svg.addEventListener("dblclick", () => zoom([...range]));
      svg.addEventListener("keydown", (event) => {
        const at = state.at ?? between(0.5);
        const [a, b] = current.window;
        const share = current.wide ? Math.log(at / a) / Math.log(b / a) : (at - a) / (b - a);
        const scaled = (by) => {
          const ends = [share - share * by, share + (1 - share) * by].map(between);
          return [Math.max(ends[0], range[0]), Math.min(ends[1], range[1])];
        };
        if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
          state.at = between(Math.min(Math.max(share + (event.key === "ArrowLeft" ? -0.02 : 0.02), 0), 1));
          read();
        } else if (event.key === "+" || event.key === "=") zoom(scaled(0.5));
        else if (event.key === "-") zoom(scaled(2));
        else if (event.key === "Escape") zoom([...range]);
        else return;
        event.preventDefault();
      });
      return { box, draw: render, read: reading };
    }

    function label(x, y, value, anchor) {
      return vector("text", { x, y, "text-anchor": anchor }, brief(value));
    }
  }

  function vector(name, attributes, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }

  function brief(value) {
    if (!Number.isFinite(value)) return "∞";
    const size = Math.abs(value);
    const text = Number(value.toPrecision(4)).toString();
    const far = size >= 1e6 || (size > 0 && size < 1e-4);
    return (far ? value.toExponential(2).replace(/\.?0+e/, "e") : text).replaceAll("-", "−");
  }

  function ticks(low, high, log) {
    const found = [];
    if (log) {
      const decades = Math.log10(high / low);
      const steps = decades > 2.5 ? [1] : decades > 1 ? [1, 2, 5] : [1, 2, 3, 4, 5, 6, 8];
      for (let p = Math.floor(Math.log10(low)); p <= Math.log10(high); p += decades > 6 ? 2 : 1) {
        found.push(...steps.map((step) => step * 10 ** p));
      }
      return found.filter((value) => value >= low * (1 - 1e-9) && value <= high * (1 + 1e-9));
    }
    const rough = (high - low) / 4;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough);
    for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12); k += 1) found.push(k * step);
    return found;
  }

  // Boundaries by environment; those that share its curves get them here.
  function prepared({ boundaries, impedances }) {
    return [...new Set(boundaries.map((one) => one.environment))].map((name) => ({
      name, ...impedances[name],
      limits: boundaries.filter((one) => one.environment === name).map((one) => ({ ...impedances[name], ...one })),
    }));
  }

  // A curve between its points: straight on logarithms where it is positive.
  function interpolated(curve, x, w) {
    const i = Math.min(Math.max(x.findIndex((edge) => edge >= w), 1), x.length - 1);
    const [low, high] = [curve[i - 1], curve[i]];
    if (low === null || high === null) return NaN;
    const share = Math.log(w / x[i - 1]) / Math.log(x[i] / x[i - 1]);
    return low > 0 && high > 0 ? low * (high / low) ** share : low + (high - low) * share;
  }

  themes();
  digits();
  sorting();
  copying();
  explorer();
})();
