"use strict";
(() => {
  const root = document.documentElement;
  const data = JSON.parse(document.getElementById("data").textContent);

  // ---- tables ------------------------------------------------------------------------------

  for (const table of document.querySelectorAll("table")) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => {
        const up = head.getAttribute("aria-sort") !== "ascending";
        heads.forEach((each) => each.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        const body = table.tBodies[0];
        const rows = [...body.rows];
        const key = (row) => row.cells[column].dataset.key;
        const sign = up ? 1 : -1;
        rows.sort((a, b) => {
          const [p, q] = [key(a), key(b)];
          if (p === "" || q === "") return (p === "") - (q === ""); // what is absent stays last
          const [x, y] = [Number(p), Number(q)];
          if (!Number.isNaN(x) && !Number.isNaN(y)) return sign * (x - y);
          return sign * p.localeCompare(q);
        });
        body.append(...rows);
      });
    });
  }

  for (const box of document.querySelectorAll("[data-filter]")) {
    const table = document.querySelector(`[aria-labelledby=${box.dataset.filter}] table`);
    box.addEventListener("input", () => {
      const words = box.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of table.tBodies[0].rows) {
        // Names are searched for a word, the force limit beside them is equal to a number or not.
        const keys = [...row.cells].slice(0, 3).map((each) => each.dataset.key.toLowerCase());
        const matches = (word) => keys.some((key) => (
          Number.isNaN(Number(key)) ? key.includes(word) : Number(key) === Number(word)));
        row.hidden = !words.every(matches);
      }
    });
  }

  // ---- theme -------------------------------------------------------------------------------

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : dark.matches);
  document.getElementById("theme").addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    redraw();
  });
  dark.addEventListener("change", () => redraw());

  const read = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const shade = (colour) => (colour === "#000000" ? read("--ink") : colour);
  const axis = (extra) => ({
    gridcolor: read("--line"),
    zerolinecolor: read("--line"),
    linecolor: read("--quiet"),
    automargin: true,
    exponentformat: "power",
    ...extra,
  });
  const narrow = () => window.innerWidth < 600;
  const layout = (extra) => ({
    paper_bgcolor: read("--paper"),
    plot_bgcolor: read("--paper"),
    font: { color: read("--ink"), size: narrow() ? 11 : 13, family: "system-ui, DejaVu Sans, sans-serif" },
    margin: { l: 10, r: 10, t: 24, b: 10 },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
    hovermode: "closest",
    hoverlabel: { bgcolor: read("--panel"), font: { color: read("--ink") } },
    ...extra,
  });
  const config = { responsive: true, displaylogo: false, displayModeBar: window.matchMedia("(hover: hover)").matches && !narrow() ? "hover" : false };

  // ---- charts that are as they are -----------------------------------------------------------

  const drawings = [];
  for (const place of document.querySelectorAll("[data-chart]")) {
    const chart = data.charts[Number(place.dataset.chart)];
    drawings.push([place, () => {
      const traces = chart.data.map((trace) => ({
        ...trace,
        ...(trace.line && { line: { ...trace.line, color: shade(trace.line.color) } }),
        ...(trace.marker && { marker: { ...trace.marker, color: shade(trace.marker.color) } }),
      }));
      return Plotly.react(place, traces, layout({
        xaxis: axis(chart.layout.xaxis),
        yaxis: axis(chart.layout.yaxis),
      }), config);
    }]);
  }

  // ---- time histories ------------------------------------------------------------------------

  function unpack(packed) {
    if (!packed.values) {
      const bytes = Uint8Array.from(atob(packed.data), (letter) => letter.charCodeAt(0));
      packed.values = new Float32Array(bytes.buffer);
    }
    return packed;
  }
  function column(packed, index) {
    const { shape, values } = unpack(packed);
    const width = shape.length > 1 ? shape[1] : 1;
    return Float32Array.from({ length: shape[0] }, (_, row) => values[row * width + index]);
  }
  const times = (start, dt, count) => Float32Array.from({ length: count }, (_, k) => start + k * dt);

  const motion = document.getElementById("motion");
  if (motion) {
    const boxes = [...document.querySelectorAll("#policies input")];
    const part = document.getElementById("part");
    const plane = document.getElementById("plane");
    const group = document.getElementById("group");
    const picked = () => {
      const names = new Set(boxes.filter((box) => box.checked).map((box) => box.value));
      return data.histories.filter(
        (each) => names.has(each.label) && (!group || each.group === group.value));
    };
    const forces = data.histories[0].first.shape[1] - 4;
    const stroke = (each) => ({ color: shade(each.colour), width: 1.6, dash: each.dash });
    const forceNames = forces === 2 ? ["force on the wheel", "force on the body"] : ["force"];
    const symbols = forces === 2 ? ["u1", "u2"] : ["u"];
    const motionTitles = ["x1, wheel [m]", "x2, body [m]", ...symbols.map((name) => `${name} [${data.unit}]`)];

    const drawMotion = () => {
      const whole = part.value === "whole";
      const rows = whole ? 2 : 2 + forces;
      const traces = [];
      for (const each of picked()) {
        for (let row = 0; row < rows; row += 1) {
          const common = {
            type: "scatter",
            mode: "lines",
            name: each.label,
            legendgroup: each.label,
            showlegend: row === 0,
            xaxis: "x",
            yaxis: row ? `y${row + 1}` : "y",
          };
          if (whole) {
            const t = column(each.middles, 0);
            const line = { ...stroke(each), width: 1.4 };
            traces.push({ ...common, x: t, y: column(each.high, row), line });
            traces.push({ ...common, x: t, y: column(each.low, row), line, showlegend: false });
          } else {
            const packed = each[part.value];
            const start = part.value === "last" ? each.last_start : each.dt;
            const index = row < 2 ? row : row + 2;
            const held = row < 2 ? {} : { shape: "hv" };
            traces.push({
              ...common,
              x: times(start, each.dt, packed.shape[0]),
              y: column(packed, index),
              line: { ...stroke(each), ...held },
            });
          }
        }
      }
      const extra = {
        xaxis: axis({ title: { text: "time [s]" }, anchor: rows > 1 ? `y${rows}` : "y" }),
        legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      };
      const gap = 0.04;
      const height = (1 - gap * (rows - 1)) / rows;
      for (let row = 0; row < rows; row += 1) {
        const top = 1 - row * (height + gap);
        extra[row ? `yaxis${row + 1}` : "yaxis"] = axis({
          domain: [Math.max(0, top - height), top],
          title: { text: motionTitles[row], standoff: 4 },
        });
      }
      return Plotly.react(motion, traces, layout(extra), config);
    };

    const phase = document.getElementById("phase");
    const drawPhase = () => {
      const traces = [];
      const byForce = plane.value === "force";
      const panels = byForce ? forces : 2;
      for (const each of picked()) {
        for (let panel = 0; panel < panels; panel += 1) {
          const mass = byForce && forces === 1 ? 1 : panel;
          // The force of a row was held over the interval before it: what the policy saw was the row before.
          const velocity = column(each.last, 2 + mass);
          traces.push({
            type: "scatter",
            mode: byForce ? "markers" : "lines",
            name: each.label,
            legendgroup: each.label,
            showlegend: panel === 0,
            xaxis: panel ? "x2" : "x",
            yaxis: panel ? "y2" : "y",
            x: byForce ? velocity.slice(0, -1) : column(each.last, mass),
            y: byForce ? column(each.last, 4 + panel).slice(1) : velocity,
            line: stroke(each),
            marker: { color: shade(each.colour), size: 4 },
          });
        }
      }
      const stacked = narrow();
      const names = byForce && forces === 1 ? ["body"] : ["wheel", "body"];
      const extra = { legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 } };
      names.forEach((name, panel) => {
        const number = panel ? "2" : "";
        const symbol = name === "wheel" ? "1" : "2";
        const last = names.length === 1;
        extra[`xaxis${number}`] = axis({
          domain: last || stacked ? [0, 1] : [panel * 0.56, panel * 0.56 + 0.44],
          anchor: `y${number}`,
          title: { text: byForce ? `v${symbol}, ${name} [m/s]` : `x${symbol}, ${name} [m]`, standoff: 4 },
        });
        extra[`yaxis${number}`] = axis({
          domain: last || !stacked ? [0, 1] : [(1 - panel) * 0.58, (1 - panel) * 0.58 + 0.42],
          anchor: `x${number}`,
          title: { text: byForce ? `${forceNames[panel]} [${data.unit}]` : `v${symbol} [m/s]`, standoff: 4 },
        });
      });
      return Plotly.react(phase, traces, layout(extra), config);
    };
    drawings.unshift([motion, drawMotion], [phase, drawPhase]);
    const update = () => {
      for (const [place, draw] of drawings.slice(0, 2)) if (place.dataset.drawn) draw();
    };
    for (const control of [...boxes, part, group].filter(Boolean)) control.addEventListener("change", update);
    plane.addEventListener("change", () => phase.dataset.drawn && drawPhase());
    for (const button of document.querySelectorAll("#policies button")) {
      button.addEventListener("click", () => {
        boxes.forEach((box) => { box.checked = Boolean(button.dataset.all); });
        update();
      });
    }
  }

  // ---- drawn when they come near the screen ----------------------------------------------------

  async function draw(place, drawing) {
    if (place.dataset.drawn) return;
    place.dataset.drawn = "begun";
    await drawing();
    place.dataset.drawn = "true";
  }
  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      watcher.unobserve(entry.target);
      draw(...drawings.find(([place]) => place === entry.target));
    }
  }, { rootMargin: "300px" });
  for (const [place] of drawings) watcher.observe(place);
  function redraw() {
    for (const [place, drawing] of drawings) if (place.dataset.drawn) drawing();
  }
  window.addEventListener("beforeprint", () => drawings.forEach(([place, drawing]) => draw(place, drawing)));
  root.dataset.ready = "true";
})();
