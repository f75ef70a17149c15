"use strict";
// The dashboard of seepd: hears the daemon's event stream and draws. No library, nothing from elsewhere.
const byId = (id) => document.getElementById(id);
const LIVE_S = 30;
const FLAGS = { no_estimate: "no estimate", healthy: "healthy", watch: "watch", leak: "leak", severe: "severe" };
const REASONS = {
  no_cycle_yet: "no complete cycle yet", unconfirmed: "too few estimates in a row above a threshold", stale: "no command arrives", stuck: "the command stands still",
  no_cycle_found: "no duty cycle is found in the command", wrong_rate: "the command comes at another rate than the model's",
  unusable_configuration: "this axis cannot be started", learning_baseline: "learning what the healthy machine is like",
};
let chosen = null, stream = null, status = null;
let live = [], cycles = [], trend = [], events = [];

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const number = (value, digits = 3) => (value === null || value === undefined) ? "–" : Number(value).toPrecision(digits);
const flowOf = (axis, area) => area === null ? null : area * axis.lpm_per_m2;
const told = (reason) => REASONS[reason] || (reason || "").replaceAll("_", " ");

function rows(table, entries) {
  table.replaceChildren(...entries.map(([name, value, bad]) => {
    const row = document.createElement("tr"), head = document.createElement("th"), cell = document.createElement("td");
    head.scope = "row";
    head.textContent = name;
    cell.textContent = value;
    if (bad) cell.className = "bad";
    row.append(head, cell);
    return row;
  }));
}

function listen() {
  if (stream) stream.close();
  live = [];
  stream = new EventSource("/api/v1/events" + (chosen ? "?axis=" + encodeURIComponent(chosen) : ""));
  stream.addEventListener("open", () => { linked(true); recall(); });
  stream.addEventListener("error", () => linked(false));
  stream.addEventListener("status", (event) => show(JSON.parse(event.data)));
  stream.addEventListener("live", (event) => {
    live.push(...JSON.parse(event.data));
    const newest = live.length ? live[live.length - 1][0] : 0;
    live = live.filter(([t]) => t > newest - LIVE_S * 1e9);
    drawLive();
  });
  for (const kind of ["cycle", "flag", "notice", "acknowledged", "test"]) {
    stream.addEventListener(kind, (event) => heard(JSON.parse(event.data)));
  }
}

function linked(good) {
  byId("link").textContent = good ? "connected" : "connection to seepd lost";
  byId("link").classList.toggle("lost", !good);
}

function choose(axis) {
  chosen = axis;
  cycles = []; trend = [];
  listen();
  // What was drawn is another axis's, and this one may be silent.
  draw();
  refresh();
}

async function refresh() {
  if (!chosen) return;
  const of = chosen, place = "/api/v1/axes/" + encodeURIComponent(of);
  try {
    const answers = await Promise.all([fetch(place + "/cycles"), fetch(place + "/trend")]);
    const [newCycles, newTrend] = await Promise.all(answers.map((answer) => answer.ok ? answer.json() : []));
    if (of !== chosen) return;
    cycles = newCycles; trend = newTrend;
    drawCycles(); drawTrend();
  } catch { /* the stream says that the connection is lost */ }
}

function show(overview) {
  status = overview;
  const names = overview.axes.map((axis) => axis.axis);
  if (!chosen || !names.includes(chosen)) {
    if (names.length) choose(names[0]);
    return;
  }
  byId("axes").replaceChildren(...overview.axes.map((axis) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = axis.axis + " · " + FLAGS[axis.flag];
    button.className = axis.flag;
    button.setAttribute("aria-pressed", axis.axis === chosen);
    button.addEventListener("click", () => choose(axis.axis));
    return button;
  }));
  const axis = overview.axes.find((axis) => axis.axis === chosen);
  showCondition(axis);
  showSource(axis);
  showRepairs(axis);
  rows(byId("sinks"), overview.sinks.length ? overview.sinks.map((sink) => {
    const counts = sink.sent + " sent, " + sink.waiting + " waiting, " + sink.dropped + " dropped";
    return [sink.name, sink.detail + " · " + counts, !sink.good];
  }) : [["none", "no sink is configured"]]);
  document.title = FLAGS[axis.flag] + " · " + axis.axis + " · seepd";
  byId("footer").textContent = "seepd " + overview.version + " · run " + overview.run + " · " +
    (overview.time || "the clock of this gateway is not set");
}

function showCondition(axis) {
  byId("condition").style.setProperty("--state", "var(--" + axis.flag + ")");
  byId("flag").textContent = FLAGS[axis.flag];
  byId("reason").textContent = axis.reason ? told(axis.reason) : axis.cycles + " cycles with an estimate";
  byId("beside").textContent = axis.condition ? "Beside the seal: " + axis.condition + axis.conditions.map(sinceText).join("") : "";
  byId("advice").textContent = axis.advice || "";
  const known = axis.flag !== "no_estimate";
  byId("flow").textContent = known ? number(axis.leak_flow_lpm) : "–";
  const low = flowOf(axis, axis.interval90_m2 ? axis.interval90_m2[0] : null);
  const high = flowOf(axis, axis.interval90_m2 ? axis.interval90_m2[1] : null);
  byId("interval").textContent = known && axis.interval90_m2
    ? number(low) + " … " + number(high) + " L/min at " + axis.reference_dp_pa / 1e5 + " bar; area " + number(axis.leak_area_m2 * 1e6) + " mm²; "
      + number(axis.leak_power_w) + " W, " + Math.round(axis.leak_energy_kwh_per_year) + " kWh a year"
    : axis.leak_flow_lpm === null ? "" : "last known " + number(axis.leak_flow_lpm) + " L/min";
  const latched = axis.latched && !axis.acknowledged;
  byId("latched").textContent = axis.latched
    ? "highest flag: " + FLAGS[axis.latched] + (axis.acknowledged ? " (acknowledged)" : " (not acknowledged)") : "";
  byId("acknowledge").hidden = !latched;
  showBaseline(axis);
}

// When a condition began; growth and what to do are in its sentence.
const sinceText = (one) => " " + one.cause.replaceAll("_", " ") + (one.manner === "drift" ? " growing" : "") + " since about " + moment(one.onset_ns)
  + " (" + moment(one.onset_range_ns[0]) + " … " + moment(one.onset_range_ns[1]) + ")" + (one.severity === "slight" ? ", slight so far." : ", large enough to matter.");

const FINDINGS = { none: "no change", leak: "more leakage than then", improved: "less leakage than then; learn a new baseline" };

const baselineText = ({ learned_cycles: cycles, occasion, learning }) =>
  learning ? "learning the healthy machine: " + learning[0] + " of " + learning[1] + " cycles"
    : cycles ? "relative to the baseline of " + cycles + " cycles (" + occasion + ")" : "no baseline: the estimate is that of the model alone";

// Seconds as a person says them.
function span(seconds) {
  const units = [["days", 86400], ["hours", 3600], ["minutes", 60]];
  const [name, size] = units.find(([, length]) => seconds >= 2 * length) || ["seconds", 1];
  return Math.round(seconds / size) + " " + name;
}

const relativeText = (axis) => axis.relative.changed
  ? baselineText(axis.baseline) + ": the command has changed in " + axis.relative.features.slice(0, 4).join(", ")
  : baselineText(axis.baseline) + (axis.baseline.learned_cycles ? ": " + FINDINGS.none : "");

function showBaseline(axis) {
  byId("baseline").textContent = axis.relative ? relativeText(axis) : axis.duty_cycles
    ? axis.duty_cycles.map((one) => one.name + " (" + one.cycles + " cycles): " + baselineText(one.baseline)).join("; ")
      + (axis.finding === "none" ? "" : " – " + FINDINGS[axis.finding])
    : baselineText(axis.baseline) + (axis.baseline.learned_cycles ? ": " + FINDINGS[axis.finding] : "");
  const range = axis.time_to_leak_range_s;
  byId("projection").textContent = axis.time_to_leak_s === null || axis.time_to_leak_s === 0 ? ""
    : "flag “leak” expected in about " + span(axis.time_to_leak_s) + " (" + span(range[0]) + " … " + span(range[1]) + ")";
  byId("renew").hidden = !axis.baseline.learned_cycles || Boolean(axis.baseline.learning);
}

const VERDICTS = { not_seen: "not seen", borne_out: "borne out", contradicted: "contradicted" };

// Times of a clock that was never set are no dates.
const moment = (ns) => ns >= 1e17 ? new Date(ns / 1e6).toLocaleString() : (ns / 1e9).toFixed(1) + " s";

function showRepairs(axis) {
  const items = [...axis.repairs].reverse().map((done) => {
    const item = document.createElement("li");
    const said = [done.who, done.note].filter(Boolean).join(": ");
    item.textContent = moment(done.t_ns) + " · " + done.what.replaceAll("_", " ") + (said ? " (" + said + ")" : "") + " · "
      + (done.text || (done.verdict ? VERDICTS[done.verdict] : "too few cycles yet"));
    if (done.verdict === "contradicted") item.className = "severe";
    return item;
  });
  if (!items.length) {
    const none = document.createElement("li");
    none.className = "none";
    none.textContent = "none";
    items.push(none);
  }
  byId("repairs").replaceChildren(...items);
}

function showSource(axis) {
  const source = axis.source, entries = [
    [source.name || "–", source.state + (source.detail ? " · " + source.detail : ""), axis.stale || source.state === "down"],
    ["frames, samples", source.frames + ", " + source.samples],
    ["cycles used", axis.cycles],
  ];
  const counts = {
    "dropped by the kernel": source.dropped_in_socket, "missing by their counter": source.missing_by_counter,
    "repeated counters": source.repeated, "counter jumps": source.counter_jumps, "malformed frames": source.malformed,
    "frames too short": source.too_short, "error frames": source.error, "remote frames": source.remote, "opened again": source.reopened,
  };
  for (const [name, count] of Object.entries(counts)) if (count) entries.push([name, count]);
  for (const [reason, count] of Object.entries(axis.rejected)) entries.push(["cycles rejected: " + told(reason), count]);
  for (const [reason, count] of Object.entries(axis.samples_rejected)) entries.push(["samples: " + told(reason), count]);
  rows(byId("source"), entries);
}

function heard(event) {
  if (event.schema === "seepd.cycle/1") {
    if (event.axis === chosen) refresh();
    return;
  }
  events.unshift(event);
  showEvents();
}

// What was told before this page was opened, or while its connection was lost.
async function recall() {
  const before = new Set(events);
  try {
    const answer = await fetch("/api/v1/history");
    if (!answer.ok) return;
    const history = (await answer.json()).reverse(), known = new Set(history.map((event) => event.id));
    const others = events.filter((event) => !known.has(event.id));
    events = [...others.filter((event) => !before.has(event)), ...history, ...others.filter((event) => before.has(event))];
    showEvents();
  } catch { /* the stream says that the connection is lost */ }
}

function showEvents() {
  events = events.slice(0, 50);
  if (events.length) byId("events").replaceChildren(...events.map(eventItem));
}

function eventItem(event) {
  const item = document.createElement("li");
  const time = event.published_at ? new Date(event.published_at).toLocaleString() : "clock not set";
  const what = {
    "seepd.event/1": () => FLAGS[event.flag_from] + " → " + FLAGS[event.flag_to] + " (" + event.text + ")",
    "seepd.notice/1": () => event.text,
    "seepd.acknowledged/1": () => "acknowledged" + (event.latched ? ": " + FLAGS[event.latched] : ""),
    "seepd.test/1": () => "test alarm",
  }[event.schema];
  item.textContent = time + " · " + event.axis + " · " + (what ? what() : event.schema);
  item.className = event.flag_to || "";
  return item;
}

// Axes with ticks, and a way from values to places on the canvas.
function plane(canvas, x, y, logarithmic) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.font = "12px system-ui, sans-serif";
  const left = 46, right = 8, top = 8, bottom = 22;
  const up = logarithmic ? Math.log10 : (value) => value;
  const placeX = (value) => left + (value - x[0]) / (x[1] - x[0]) * (width - left - right);
  const placeY = (value) => height - bottom - (up(value) - up(y[0])) / (up(y[1]) - up(y[0])) * (height - top - bottom);
  pen.strokeStyle = color("line"); pen.fillStyle = color("soft"); pen.lineWidth = 1;
  const ticksY = logarithmic ? decades(y) : ticks(y, 5);
  pen.textAlign = "right"; pen.textBaseline = "middle";
  for (const value of ticksY) {
    pen.beginPath(); pen.moveTo(left, placeY(value)); pen.lineTo(width - right, placeY(value)); pen.stroke();
    pen.fillText(String(Number(value.toPrecision(3))), left - 6, placeY(value));
  }
  pen.textAlign = "center"; pen.textBaseline = "top";
  for (const value of ticks(x, 6)) pen.fillText(String(Number(value.toPrecision(6))), placeX(value), height - bottom + 5);
  return { pen, placeX, placeY, line(points, style, thickness = 1.5) {
    pen.strokeStyle = style; pen.lineWidth = thickness; pen.beginPath();
    points.forEach(([a, b], index) => index ? pen.lineTo(placeX(a), placeY(b)) : pen.moveTo(placeX(a), placeY(b)));
    pen.stroke();
  } };
}

function ticks([low, high], about) {
  const raw = (high - low) / about, size = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * size).find((step) => step >= raw);
  const all = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + step * 1e-9; value += step) all.push(value);
  return all;
}

function decades([low, high]) {
  const all = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (const factor of high / low > 500 ? [1] : high / low > 20 ? [1, 3] : [1, 1.5, 2, 3, 5, 7]) {
      const value = factor * 10 ** power;
      if (value >= low && value <= high) all.push(value);
    }
  }
  return all;
}

function range(values, least) {
  let low = Math.min(...values), high = Math.max(...values);
  if (!(high - low >= least)) { const middle = (low + high) / 2; low = middle - least / 2; high = middle + least / 2; }
  const air = (high - low) * 0.05;
  return [low - air, high + air];
}

function empty(canvas, text) {
  const { pen } = plane(canvas, [0, 1], [0, 1]);
  pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  pen.fillStyle = color("soft"); pen.textAlign = "center";
  pen.fillText(text, canvas.clientWidth / 2, canvas.clientHeight / 2);
}

function drawLive() {
  if (live.length < 2) return empty(byId("live"), "no command yet");
  const newest = live[live.length - 1][0];
  const points = live.map(([t, command]) => [(t - newest) / 1e9, command]);
  plane(byId("live"), [-LIVE_S, 0], range(points.map((point) => point[1]), 0.1)).line(points, color("accent"));
}

function drawCycles() {
  byId("cycle-list").replaceChildren(...[...cycles].reverse().map((cycle) => {
    const item = document.createElement("li");
    item.className = cycle.flag;
    item.textContent = "cycle " + cycle.cycle + " · " + (cycle.reason ? "rejected: " + told(cycle.reason)
      : number(cycle.leak_flow_lpm) + " L/min · " + FLAGS[cycle.flag]);
    return item;
  }));
  const shown = cycles.filter((cycle) => cycle.points.length > 1);
  if (!shown.length) return empty(byId("cycles"), "no cycle yet");
  const all = shown.flatMap((cycle) => cycle.points);
  const picture = plane(byId("cycles"), [0, Math.max(...all.map((point) => point[0]))], range(all.map((point) => point[1]), 0.1));
  shown.forEach((cycle, index) => {
    const newest = index === shown.length - 1;
    picture.pen.globalAlpha = newest ? 1 : 0.25 + 0.5 * index / shown.length;
    picture.line(cycle.points, color(cycle.reason ? "no_estimate" : cycle.flag), newest ? 2 : 1);
    picture.pen.globalAlpha = 1;
  });
}

// Time before now in a unit that fits; by number of cycles where the clock was set in between, which is no time at all.
function timeScale(points) {
  const newest = points[points.length - 1].t_ns, span = newest - points[0].t_ns, years = 5 * 365 * 864e11;
  const stepped = points.some((point, index) => index && point.t_ns < points[index - 1].t_ns) || span > years;
  if (stepped) return { at: (_, index) => index - points.length + 1, name: "cycles" };
  const units = [[864e11, "days"], [36e11, "h"], [6e10, "min"], [1e9, "s"]];
  const [unit, name] = units.find(([unit]) => span > 2 * unit) || units[3];
  return { at: (point) => (point.t_ns - newest) / unit, name };
}

function drawTrend() {
  const canvas = byId("trend");
  const axis = status?.axes.find((axis) => axis.axis === chosen);
  if (!trend.length || !axis || !axis.lpm_per_m2) return empty(canvas, "no estimate yet");
  const flow = (area) => Math.max(flowOf(axis, area), 1e-3);
  const { at, name } = timeScale(trend);
  const low = Math.max(Math.min(...trend.map((point) => flow(point.interval90_m2[0]))), 0.005);
  const high = Math.max(...trend.map((point) => flow(point.interval90_m2[1])), low * 3);
  const picture = plane(canvas, [Math.min(at(trend[0], 0), -1e-3), 0], [low / 1.2, high * 1.2], true);
  const clip = (value) => Math.max(value, low / 1.2);
  picture.pen.fillStyle = color("band");
  picture.pen.beginPath();
  const edge = (point, index, end) => picture.pen.lineTo(picture.placeX(at(point, index)), picture.placeY(clip(flow(point.interval90_m2[end]))));
  trend.forEach((point, index) => edge(point, index, 1));
  [...trend].reverse().forEach((point, index) => edge(point, trend.length - 1 - index, 0));
  picture.pen.fill();
  picture.line(trend.map((point, index) => [at(point, index), clip(point.leak_flow_lpm)]), color("accent"), 2);
  for (const done of axis.repairs) markRepair(picture, canvas, done, at);
  picture.pen.fillStyle = color("soft"); picture.pen.textAlign = "left"; picture.pen.textBaseline = "top";
  picture.pen.fillText(name + " before now", 52, 10);
}

// A repair on the trend: before the first cycle that ended after it.
function markRepair({ pen, placeX }, canvas, done, at) {
  const index = trend.findIndex((point) => point.t_ns >= done.t_ns);
  if (index < 0 || done.t_ns < trend[0].t_ns) return;
  const x = placeX(at(trend[index], index));
  pen.save();
  pen.setLineDash([4, 3]); pen.strokeStyle = color("soft"); pen.lineWidth = 1;
  pen.beginPath(); pen.moveTo(x, 8); pen.lineTo(x, canvas.clientHeight - 22); pen.stroke();
  pen.translate(x + 4, 24); pen.fillStyle = color("soft"); pen.textAlign = "left"; pen.textBaseline = "top";
  pen.fillText(done.what.replaceAll("_", " "), 0, 0);
  pen.restore();
}

// Asks the chosen axis for something, and says where it is not taken.
async function order(word, body) {
  try {
    const answer = await fetch("/api/v1/axes/" + encodeURIComponent(chosen) + "/" + word, { method: "POST", body });
    if (!answer.ok) alert((await answer.json()).error);
    return answer.ok;
  } catch (error) {
    alert("seepd does not answer: " + error.message);
    return false;
  }
}

byId("acknowledge").addEventListener("click", () => order("acknowledge"));
byId("renew").addEventListener("click", () => {
  const question = "Is the machine healthy now? A new baseline will be learned from the next cycles, with whatever leaks; the old one is kept as a record.";
  if (confirm(question)) order("new-baseline");
});
byId("repair").addEventListener("submit", async (event) => {
  event.preventDefault();
  const entry = { what: byId("repair-what").value, who: byId("repair-who").value, note: byId("repair-note").value };
  if (await order("repairs", JSON.stringify(entry))) byId("repair-note").value = "";
});

function draw() { drawLive(); drawCycles(); drawTrend(); }

addEventListener("resize", draw);
draw();
listen();
