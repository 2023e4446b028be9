// How often each topic arrives, beside how often it should. A click on a row chooses the topic for a plot.
export default {
  template: `<table class="links" v-if="rows?.length"><thead><tr><th>topic</th><th>expected (Hz)</th><th>seen (Hz)</th><th>age</th></tr></thead>
    <tbody><tr v-for="row in rows" :key="row.name" :class="{ late: row.late }" :title="'from ' + row.writer" @click="$emit('plot', row.name)">
    <td><b v-if="row.late">!</b> {{ row.name }}</td><td>{{ row.expected }}</td><td>{{ row.seen }}</td><td>{{ row.age }}</td></tr></tbody></table>`,
  props: { rows: Array },
};
