"use strict";
// Draws every figure in the colours of the page, keeps a still of each for print, copies tables.
const dark = window.matchMedia("(prefers-color-scheme: dark)");

function coloured(layout, isDark) {
  const ink = isDark ? "#e6e7ea" : "#1c1e21", grid = isDark ? "#353a41" : "#e3e5e9";
  const painted = { ...layout, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: ink, size: 12, family: "system-ui, sans-serif" } };
  const shade = (axis) => ({ gridcolor: grid, zerolinecolor: isDark ? "#6a6f78" : "#a9adb5",
    linecolor: grid, ...axis });
  for (const key of Object.keys(painted)) if (/^[xy]axis\d*$/.test(key)) painted[key] = shade(painted[key]);
  if (painted.scene) {
    painted.scene = { ...painted.scene };
    for (const key of ["xaxis", "yaxis", "zaxis"])
      painted.scene[key] = { ...shade(painted.scene[key]), backgroundcolor: "rgba(0,0,0,0)" };
  }
  return painted;
}

async function still(node, figure) {
  // on paper ink is black, the page is narrow, and scenes in space are pictures
  const width = Math.max(720, parseInt(node.style.minWidth) || 0), height = figure.layout.height;
  const content = { data: figure.data, layout: { ...coloured(figure.layout, false), width, updatemenus: [] } };
  const format = figure.layout.scene ? "png" : "svg";
  const picture = document.getElementById(node.id + "-still");
  picture.src = await Plotly.toImage(content, { format, width, height, scale: format === "png" ? 2 : 1 });
  node.classList.add("kept"); // until then paper shows the figure itself
}

async function draw(node) {
  const figure = JSON.parse(document.getElementById(node.id + "-data").textContent);
  const shown = () => Plotly.react(node, figure.data, coloured(figure.layout, dark.matches),
    { responsive: true, displaylogo: false, displayModeBar: "hover" });
  await shown();
  dark.addEventListener("change", shown);
  await still(node, figure);
}

async function copy(button) {
  const rows = [...button.closest(".table").querySelectorAll("tr")];
  const text = rows.map((row) => [...row.cells].map((c) => c.textContent.trim()).join("\t"));
  await navigator.clipboard.writeText(text.join("\n"));
  button.textContent = "copied";
}

function unfold(details) {
  // a figure drawn while hidden does not know its width
  for (const node of details.querySelectorAll(".plot")) if (node.layout) Plotly.Plots.resize(node);
}

// on paper nothing can be opened
window.addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll("details")) details.open = true;
});

document.addEventListener("DOMContentLoaded", async () => {
  for (const details of document.querySelectorAll("details"))
    details.addEventListener("toggle", () => unfold(details));
  for (const button of document.querySelectorAll("button.copy"))
    button.addEventListener("click", () => copy(button));
  for (const node of document.querySelectorAll(".plot")) await draw(node);
  document.body.dataset.drawn = "all";
});
