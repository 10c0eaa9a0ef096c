"""Contrast of all text of a page, as WCAG 2.2 measures it, and what axe-core finds in the page."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

MEASURE = r"""
() => {
  const parse = text => {
    const found = text.match(/rgba?\(([^)]+)\)/);
    const parts = found ? found[1].split(/[ ,\/]+/).map(Number) : null;
    return parts && [parts[0], parts[1], parts[2], parts.length > 3 ? parts[3] : 1];
  };
  const over = (top, ground) =>
    [0, 1, 2].map(i => top[i] * top[3] + ground[i] * (1 - top[3])).concat([1]);
  const luminance = colour => {
    const [r, g, b] = [0, 1, 2].map(i => {
      const v = colour[i] / 255;
      return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = element => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) {
      const colour = parse(getComputedStyle(e).backgroundColor);
      if (colour && colour[3] > 0) layers.push(colour);
      if (colour && colour[3] === 1) break;
    }
    return layers.reverse().reduce((below, top) => over(top, below), [255, 255, 255, 1]);
  };
  document.getAnimations().forEach(a => { try { a.finish(); } catch { a.cancel(); } });
  const weak = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const e = node.parentElement, style = getComputedStyle(e), text = node.textContent.trim();
    const idle = 'script, style, noscript, [disabled], .disabled, .q-tooltip';
    if (!text || e.closest(idle) || !e.checkVisibility({visibilityProperty: true})) continue;
    const drawn = e.closest('svg'), colour = parse(drawn ? style.fill : style.color);
    if (!colour) continue;
    for (let k = e; k; k = k.parentElement) colour[3] *= Number(getComputedStyle(k).opacity);
    const below = ground(e), pair = [luminance(over(colour, below)), luminance(below)].sort();
    const ratio = (Math.max(...pair) + 0.05) / (Math.min(...pair) + 0.05);
    const large = parseFloat(style.fontSize) >= 24 || e.closest('.q-icon');
    if (colour[3] > 0.05 && ratio < (large ? 3 : 4.5))
      weak.push(`${ratio.toFixed(2)} ${text.slice(0, 40)}`);
  }
  return [...new Set(weak)];
}
"""

BROKEN = """() => axe.run(document, { resultTypes: ["violations"] }).then((r) => r.violations)"""


def weak_texts(page: Any) -> list[str]:
    """Ratio and text of what is below 4.5, or below 3 for large text and icons."""
    found: list[str] = page.evaluate(MEASURE)
    return found


def violations(page: Any) -> list[str]:
    """Rule and element of what axe-core objects to; none where it is absent (`make partners`).

    The contrast of text in figures is for `weak_texts`: axe does not measure it.
    """
    if find_spec("axe_playwright_python") is None:
        return []
    from axe_playwright_python.sync_playwright import Axe

    if page.evaluate("!window.axe"):  # its script is half a megabyte
        page.evaluate(Axe().axe_script)
    broken = page.evaluate(BROKEN)
    return [f"{rule['id']}: {node['html'][:200]}" for rule in broken for node in rule["nodes"]]
