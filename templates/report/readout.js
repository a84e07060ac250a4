// Show the values of a chart's curves on hover, tap or arrow keys. The page is complete without this script.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const decode = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const digits = (value) => Number.isNaN(value) ? "–" : (Math.abs(value) < 1e-3 && value !== 0 ? value.toExponential(4) : String(Number(value.toPrecision(6))));
  const clamp = (value, most) => Math.max(0, Math.min(most, value));

  const enliven = (figure) => {
    const svg = figure.querySelector("svg");
    const out = figure.querySelector(".readout");
    let chart = null;
    let cursor = null;
    let at = { panel: 0, sample: 0 };

    const load = () => {
      if (chart) return;
      chart = JSON.parse(figure.querySelector("script").textContent);
      for (const panel of chart.panels) for (const curve of panel.curves) curve.values = decode(curve.values);
      cursor = document.createElementNS(SVG, "line");
      cursor.setAttribute("class", "cursor");
      svg.append(cursor);
    };

    const hide = () => {
      out.hidden = true;
      if (cursor) cursor.setAttribute("visibility", "hidden");
    };

    const show = (nearest) => {
      const panel = chart.panels[at.panel];
      const time = chart.start + at.sample * chart.spacing;
      const x = chart.left + ((chart.right - chart.left) * at.sample) / Math.max(1, chart.last);
      for (const [name, value] of Object.entries({ x1: x, x2: x, y1: panel.top, y2: panel.bottom })) cursor.setAttribute(name, value);
      cursor.setAttribute("visibility", "visible");
      const head = document.createElement("span");
      head.dataset.time = time;
      head.textContent = `${Number(time.toPrecision(8))} ${chart.unit}, ${panel.title}`;
      const lines = panel.curves.map((curve) => {
        const line = document.createElement("span");
        const key = document.createElement("i");
        key.style.setProperty("--own", curve.colour);
        line.dataset.engine = curve.engine;
        line.dataset.value = curve.values[at.sample];
        line.classList.toggle("nearest", curve.label === nearest);
        line.append(key, `${curve.label}: ${digits(curve.values[at.sample])}${panel.unit ? ` ${panel.unit}` : ""}`);
        return line;
      });
      out.replaceChildren(head, ...lines);
      out.hidden = false;
      const box = svg.getBoundingClientRect();
      const left = (x / chart.width) * box.width;
      out.style.left = left < box.width / 2 ? `${left + 12}px` : "auto";
      out.style.right = left < box.width / 2 ? "auto" : `${figure.clientWidth - left + 12}px`;
      out.style.top = `${(panel.top / chart.height) * box.height}px`;
    };

    const point = (event) => {
      load();
      const box = svg.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * chart.width;
      const y = ((event.clientY - box.top) / box.height) * chart.height;
      const panel = chart.panels.findIndex((each) => y <= each.bottom + 12);
      at.panel = panel < 0 ? chart.panels.length - 1 : panel;
      at.sample = clamp(Math.round(((x - chart.left) / (chart.right - chart.left)) * chart.last), chart.count - 1);
      show(event.target.dataset && event.target.dataset.label);
    };

    const key = (event) => {
      const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      if (event.key === "Escape") return hide();
      if (!(event.key in moves)) return undefined;
      load();
      event.preventDefault();
      const [samples, panels] = moves[event.key];
      at.sample = clamp(at.sample + samples * (event.shiftKey ? 20 : 1), chart.count - 1);
      at.panel = clamp(at.panel + panels, chart.panels.length - 1);
      return show();
    };

    svg.addEventListener("pointermove", point);
    svg.addEventListener("pointerdown", point);
    svg.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && hide());
    svg.addEventListener("blur", hide);
    svg.addEventListener("keydown", key);
    document.addEventListener("pointerdown", (event) => figure.contains(event.target) || hide());
  };
  document.querySelectorAll("figure[data-chart]").forEach(enliven);

  // a link to a folded part opens it
  const open = () => {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target && target.tagName === "DETAILS") target.open = true;
  };
  addEventListener("hashchange", open);
  open();
})();
