// Tells when nothing comes from the server any more: what the page shows is old then, though nothing else in it changes.
const LATE_MS = 3000; // the server sends ten times a second
const PERIOD_MS = 500;

export default {
  template: `<div v-if="silent_s" class="watchdog" role="alert">Nothing from the ground station for {{ silent_s }} s: what this page shows is old.</div>`,
  data() {
    return { silent_s: 0 };
  },
  mounted() {
    this.last = performance.now();
    this.checked = this.last;
    this.listen = () => (this.last = performance.now());
    this.timer = setInterval(() => this.check(), PERIOD_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    this.socket?.offAny(this.listen);
  },
  methods: {
    check() {
      if (!this.socket && window.socket) this.socket = window.socket.onAny(this.listen); // it comes after this component
      const now = performance.now();
      // A browser that was asleep itself has had no chance to read: it gets some time first.
      if (now - this.checked > LATE_MS) this.last = now;
      this.checked = now;
      const silent = now - this.last;
      this.silent_s = silent > LATE_MS ? Math.floor(silent / 1000) : 0;
    },
  },
};
