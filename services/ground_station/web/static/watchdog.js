// Notices in the browser that nothing comes from the server any more: its words take the place of the state, and the page
// turns grey (body.server-silent). No timer of the server could do so.
const LATE_MS = 1400; // the server sends ten times a second
const PERIOD_MS = 200;
const BUSY_MAX_MS = 600; // a browser that was busy or asleep for longer has had no chance to read in that time

export default {
  template: `<div v-if="silent_s" class="watchdog" role="alert"><div class="state-lost">No ground station</div>
    <div class="state-why">The ground station is silent for {{ silent_s }} s: what this page shows is old.</div></div>`,
  data() {
    return { silent_s: 0 };
  },
  mounted() {
    this.silent = 0;
    this.checked = performance.now();
    this.listen = () => (this.silent = 0);
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
      this.silent += Math.min(now - this.checked, BUSY_MAX_MS);
      this.checked = now;
      this.silent_s = this.silent > LATE_MS ? Math.floor(this.silent / 1000) : 0;
      document.body.classList.toggle("server-silent", this.silent_s > 0);
    },
  },
};
