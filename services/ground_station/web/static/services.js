// Each service with the state and the sentence that it published.
const MARKS = { ok: "✓", starting: "…", degraded: "!", silent: "✕" };

export default {
  template: `<ul class="services"><li v-for="row in rows" :key="row.name" :class="row.state">
    <b>{{ marks[row.state] }}</b><span><strong>{{ row.name }}</strong> {{ row.text }}</span></li>
    <li v-if="!rows?.length" class="silent"><b>✕</b><span>no service is heard</span></li></ul>`,
  props: { rows: Array },
  data() {
    return { marks: MARKS };
  },
};
