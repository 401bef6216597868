"""The bare page of a report: its style, its script for dark mode and print, and the frame."""

import html

STYLE = """
:root { --paper: #ffffff; --ink: #1b1f24; --soft: #57606a; --line: #d0d7de; --mark: #eef3f8; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14171b; --ink: #e6e8eb; --soft: #9aa4ae; --line: #363d45; --mark: #1f2730; }
}
@media print {
  :root { --paper: #ffffff; --ink: #000000; --soft: #444444; --line: #bbbbbb; --mark: #f2f2f2; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 1100px; background: var(--paper);
  color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.3rem; margin: 0.5rem 0; }
h2 { font-size: 1.1rem; margin: 2rem 0 0.3rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1rem 0 0; }
.verdict { font-size: 1.25rem; line-height: 1.4; margin: 0.8rem 0 1.2rem; }
.soft, figcaption { color: var(--soft); font-size: 0.9rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.85rem; }
th, td { padding: 0.25rem 0.45rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
th { vertical-align: bottom; font-weight: 600; }
th.left, td.left { text-align: left; }
td.better { font-weight: 700; background: var(--mark); }
td.better::after { content: "*"; }
td:not(.better):not(.left)::after { content: "*"; visibility: hidden; }
figure { margin: 0.5rem 0; min-width: 0; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); }
@media (max-width: 600px) { .modebar { display: none !important; } }
@media print {
  body { padding: 0; font-size: 11px; }
  table { font-size: 8px; }
  th, td { padding: 0.15rem 0.25rem; }
  figure, table { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  .pair { display: block; }
  .modebar { display: none; }
}
"""

SCRIPT = """
const dark = matchMedia("(prefers-color-scheme: dark)");
function paint(printing) {
  document.body.style.maxWidth = printing ? "17cm" : "";  // a sheet of A4 or letter
  const night = dark.matches && !printing;
  const ink = night ? "#e6e8eb" : "#1b1f24", line = night ? "#363d45" : "#d0d7de";
  for (const plot of document.querySelectorAll(".js-plotly-plot")) {
    const change = { "font.color": ink };
    const axes = Object.keys(plot._fullLayout).filter(key => /^[xy]axis[0-9]*$/.test(key));
    if (plot._fullLayout.scene) axes.push("scene.xaxis", "scene.yaxis", "scene.zaxis");
    for (const axis of axes) {
      change[axis + ".gridcolor"] = change[axis + ".zerolinecolor"] = line;
      change[axis + ".linecolor"] = line;
    }
    const inked = plot.data.flatMap((trace, i) => trace.meta === "ink" ? [i] : []);
    const style = inked.length ? { "line.color": night ? "#ffffff" : "#000000" } : {};
    Plotly.update(plot, style, change, inked.length ? inked : undefined);
    Plotly.Plots.resize(plot);  // drawn before the page had its shape
  }
}
dark.addEventListener("change", () => paint());
addEventListener("beforeprint", () => paint(true));
addEventListener("afterprint", () => paint(false));
paint();
"""


def page_of_markdown(title: str, text: str) -> str:
    """A whole HTML page of a Markdown document with tables."""
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    wide = body.replace("<table>", '<div class="wide"><table>').replace(
        "</table>", "</table></div>"
    )
    return page(title, wide, "")


def page(title: str, body: str, library: str) -> str:
    """A whole HTML page that needs nothing else; library: the JavaScript of plotly."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n"
        f"<script>{library}</script>\n</head>\n<body>\n{body}\n"
        f"<script>{SCRIPT}</script>\n</body>\n</html>\n"
    )
