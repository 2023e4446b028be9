// Tells the server now and then that somebody uses the page, so that the log-in does not end during a flight.
const PERIOD_MS = 20000;
const TYPES = ["pointerdown", "pointermove", "keydown", "wheel", "touchstart"];

export default {
  template: "<span hidden></span>",
  mounted() {
    this.last = -PERIOD_MS;
    this.listen = () => {
      if (performance.now() - this.last < PERIOD_MS) return;
      this.last = performance.now();
      this.$emit("used");
    };
    for (const type of TYPES) window.addEventListener(type, this.listen, { capture: true, passive: true });
  },
  unmounted() {
    for (const type of TYPES) window.removeEventListener(type, this.listen, { capture: true });
  },
};
