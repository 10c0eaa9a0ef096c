/* A table that is wider than its place is reached by Tab, and scrolls by the arrows then. */
const tables = {
  look() {
    for (const node of document.querySelectorAll(".q-table__middle")) {
      tables.sizes.observe(node); // a second time is none
      const wide = node.scrollWidth > node.clientWidth || node.scrollHeight > node.clientHeight;
      if (wide === node.hasAttribute("tabindex")) continue;
      if (wide) node.tabIndex = 0;
      else node.removeAttribute("tabindex");
    }
  },
  soon: () => requestAnimationFrame(tables.look),
  sizes: new ResizeObserver(() => tables.soon()),
};

new MutationObserver(tables.soon).observe(document, { childList: true, subtree: true });
