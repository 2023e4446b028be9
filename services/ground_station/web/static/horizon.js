// Artificial horizon with a compass strip.
export default {
  template: `<svg class="horizon" :class="{ late: !attitude || attitude.late }" viewBox="-50 -50 100 100" role="img" :aria-label="words">
    <defs><clipPath id="face"><circle r="48" /></clipPath></defs>
    <g clip-path="url(#face)"><g v-if="attitude" :transform="'rotate(' + -attitude.roll + ') translate(0 ' + attitude.pitch + ')'">
      <rect x="-150" y="-150" width="300" height="150" fill="#3a86c8" /><rect x="-150" width="300" height="150" fill="#8a5233" />
      <path d="M-150 0H150M-12 -10H12M-20 -20H20M-12 10H12M-20 20H20" stroke="#fff" stroke-width="1" /></g>
      <rect v-else x="-50" y="-50" width="100" height="100" fill="#4b5563" />
      <g v-if="attitude" :transform="'rotate(' + -attitude.yaw + ')'">
        <text v-for="(name, i) in ['N', 'E', 'S', 'W']" :key="name" :transform="'rotate(' + 90 * i + ') translate(0 -37)'" class="compass">{{ name }}</text></g></g>
    <path d="M-24 0H-9L0 6L9 0H24" fill="none" stroke="#ffd34d" stroke-width="2.5" /><path d="M-3 -49H3L0 -43Z" fill="#ffd34d" />
    <circle r="48" fill="none" stroke="#0d1117" stroke-width="3" /></svg>`,
  props: { attitude: Object },
  computed: {
    words() {
      const a = this.attitude;
      return a ? `roll ${a.roll}°, pitch ${a.pitch}°, heading ${a.yaw}°` : "no attitude";
    },
  },
};
