// Space hovers and Esc aborts, also while a button has the focus: Space must not press that button again. Esc first closes
// what is open: dialogs and menus do that themselves, a goal that waits for its confirmation is withdrawn.
const OPEN = ".q-dialog, .q-menu", CONFIRMING = ".confirming";
const TEXT = "input:not([type=checkbox], [type=radio], [type=range], [type=file]), textarea, [contenteditable]";

const isShown = (selector) => [...document.querySelectorAll(selector)].some((each) => each.checkVisibility());

export default {
  template: "<span hidden></span>",
  mounted() {
    this.listen = (event) => {
      const typing = event.target.matches?.(TEXT) && !event.target.readOnly;
      if (event.key === "Escape") {
        if (event.type !== "keydown" || event.repeat || isShown(OPEN)) return;
        this.$emit(isShown(CONFIRMING) ? "close" : "abort");
      } else if (event.key === " " && !typing) {
        event.preventDefault();
        event.stopPropagation();
        if (event.type === "keydown" && !event.repeat) this.$emit("hover");
      }
    };
    for (const type of ["keydown", "keyup"]) window.addEventListener(type, this.listen, true);
  },
  unmounted() {
    for (const type of ["keydown", "keyup"]) window.removeEventListener(type, this.listen, true);
  },
};
