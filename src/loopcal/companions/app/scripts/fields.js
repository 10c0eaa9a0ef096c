/* What a user is writing stays, whatever the server says meanwhile.

   The field with the focus keeps its text. Where the server sets another one, a field that the user
   has written in states its own again, and one that is untouched shows it as soon as it is left. A
   field that is drawn anew takes over text, caret, focus and open list from the one before it, by
   its label. A field for a number does not say where its caret stands: all of it is selected again
   until a user writes or puts the caret somewhere. What was written is sent by the event "commit":
   at Enter, and where the field is left. */
const fields = {
  held: null, // { node, label, text, typed, placed, open, later }

  valueProperty: Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value"),

  /* Whether a user writes there; a list to choose from shows what was chosen. */
  written: (node) => !node.closest(".q-select"),

  hold(node) {
    const label = node.getAttribute("aria-label");
    fields.held = { node, label, typed: false, placed: false, later: null };
    fields.note();
    if (!fields.written(node)) return;
    const { get, set } = fields.valueProperty;
    Object.defineProperty(node, "value", {
      configurable: true,
      get: () => get.call(node),
      set: (text) => {
        if (fields.held?.node !== node) set.call(node, text);
        else if (fields.held.typed) setTimeout(fields.state, 0, node);
        else fields.held.later = text;
      },
    });
  },

  /* Remember what is written, and whether its list is open. */
  note() {
    const { held } = fields;
    held.text = held.node.value;
    held.open = held.node.getAttribute("aria-expanded") === "true";
  },

  /* Remember whether a user has put the caret somewhere in the field. */
  place(node, so) {
    if (fields.held?.node === node) fields.held.placed = so;
  },

  /* Tell page and server what the field says. */
  state: (node) => node.dispatchEvent(new Event("input", { bubbles: true })),

  commit() {
    const { held } = fields;
    if (!held.typed) return;
    Object.assign(held, { typed: false, placed: true, later: null });
    held.node.dispatchEvent(new CustomEvent("commit", { detail: held.node.value }));
  },

  release() {
    fields.commit();
    const { node, later } = fields.held;
    fields.held = null;
    delete node.value;
    if (later !== null) node.value = later;
  },

  /* Where the field was drawn anew, give what it had to the new one. */
  pass() {
    const { held } = fields;
    if (!held || held.node.isConnected || !held.label) return;
    const named = `input[aria-label="${CSS.escape(held.label)}"]`;
    const node = document.querySelector(named);
    if (!node) return;
    const { text, typed, placed, open } = held;
    const caret = [held.node.selectionStart, held.node.selectionEnd]; // as it is at this moment
    fields.held = null;
    node.focus({ preventScroll: true });
    if (typed) {
      fields.valueProperty.set.call(node, text);
      fields.state(node);
    }
    if (caret[0] !== null) node.setSelectionRange(...caret);
    else if (!typed && !placed) node.select();
    if (fields.held) fields.held.placed = placed;
    if (open) node.closest(".q-field__control, .q-field").click();
  },
};

addEventListener("focusin", ({ target }) => {
  if (fields.held?.node === target) return;
  if (fields.held?.node.isConnected) fields.release();
  fields.held = null;
  if (target.matches(".q-field input")) fields.hold(target);
});
addEventListener("pointerdown", () => {
  if (!fields.held?.node.isConnected) fields.held = null;
}, true);
addEventListener("input", ({ target }) => {
  if (fields.held?.node !== target) return;
  fields.held.typed = true;
  fields.note();
});
addEventListener("select", ({ target }) => fields.place(target, false));
addEventListener("click", ({ target, detail }) => fields.place(target, detail < 2));
addEventListener("keydown", ({ target, key }) => {
  if (["ArrowLeft", "ArrowRight", "Home", "End"].includes(key)) fields.place(target, true);
  if (key === "Enter" && fields.held?.node === target) fields.commit();
}, true);
addEventListener("focusout", ({ target }) => {
  // a field that is taken out of the page loses the focus too: its text passes on
  queueMicrotask(() => {
    if (fields.held?.node === target && target.isConnected) fields.release();
  });
});
for (const event of ["selectionchange", "click", "keyup"])
  document.addEventListener(event, () => fields.held?.node.isConnected && fields.note());
new MutationObserver(() => fields.pass()).observe(document, { childList: true, subtree: true });
