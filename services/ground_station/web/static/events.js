// The last events in words.
const MARKS = { good: "✓", plain: "•", warning: "!", bad: "✕" };

export default {
  template: `<ol class="events"><li v-for="(row, i) in rows" :key="i" :class="row.tone">
    <b>{{ marks[row.tone] }}</b><span>{{ row.text }}</span><time>{{ row.age }}</time></li></ol>`,
  props: { rows: Array },
  data() {
    return { marks: MARKS };
  },
};
