// Values with their units and ages; what is late is grey.
export default {
  template: `<div class="readings">
    <div v-for="row in rows" :key="row.label" class="reading" :class="{ late: row.late }">
      <span class="reading-label">{{ row.label }}</span>
      <span class="reading-value">{{ row.text }}<small v-if="row.unit">{{ row.unit }}</small></span>
      <span class="reading-age">{{ row.age === "now" ? "" : row.age }}</span>
    </div></div>`,
  props: { rows: Array },
};
