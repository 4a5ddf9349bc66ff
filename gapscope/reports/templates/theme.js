/* Gives figures that were drawn elsewhere the colours of the page, again when it turns dark or light. */
"use strict";

(() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const lastInk = "#1f2328"; // of curves that were drawn in the colour of ink
  function follow() {
    document.querySelectorAll(".js-plotly-plot").forEach((figure) => {
      const change = { paper_bgcolor: colour("card"), plot_bgcolor: colour("card"), "font.color": colour("ink") };
      Object.keys(figure._fullLayout).filter((name) => /^[xy]axis\d*$/.test(name)).forEach((name) => {
        change[name + ".gridcolor"] = colour("grid");
        change[name + ".zerolinecolor"] = colour("zero");
      });
      const dark = figure.data.map((trace, k) => [trace, k]).filter(([trace]) => (trace.line || {}).color === (figure.ink || lastInk));
      if (dark.length) Plotly.restyle(figure, { "line.color": colour("ink") }, dark.map(([, k]) => k));
      figure.ink = colour("ink");
      Plotly.relayout(figure, change);
    });
  }
  const root = document.documentElement.dataset;
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", follow);
  window.addEventListener("beforeprint", () => { root.theme = "light"; follow(); });
  window.addEventListener("afterprint", () => { delete root.theme; follow(); });
  follow();
})();
