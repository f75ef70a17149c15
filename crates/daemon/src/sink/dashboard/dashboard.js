"use strict";
// The dashboard of seepd: hears the daemon's event stream and draws. No library, nothing from elsewhere.
const byId = (id) => document.getElementById(id);
const LIVE_S = 30, HOUR_NS = 36e11, DAY_NS = 864e11, EVENTS = 200;
const FLAGS = { no_estimate: "no estimate", healthy: "healthy", watch: "watch", leak: "leak", severe: "severe" };
let chosen = null, stream = null, status = null, reasons = {};
let live = [], cycles = [], trend = [], events = [], healthy = null, phases = [];
// What of the trend is shown, ns, and the points that are read.
let view = null, readAt = { trend: null, cycle: null };

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const number = (value, digits = 3) => (value === null || value === undefined) ? "–" : String(Number(Number(value).toPrecision(digits)));
const spaced = (name) => (name || "").replaceAll("_", " ");
const told = (reason) => reasons[reason]?.meaning || spaced(reason);
const axisNow = () => status?.axes.find((axis) => axis.axis === chosen);
const flowOf = (axis, area) => area === null ? null : area * axis.lpm_per_m2;
const mm2 = (area) => number(area * 1e6);

// Times of a clock that was never set are no dates.
const isDate = (ns) => ns >= 1e17;
const moment = (ns) => isDate(ns) ? new Date(ns / 1e6).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" }) : (ns / 1e9).toFixed(1) + " s";
// An axis's own time, which a log's may be.
const nowOf = (axis) => axis.stale || axis.t_sample_ns === null ? status.now_ns : axis.t_sample_ns;

// For how long it has been what it is; nothing where the two times are not of one clock.
function howLong(axis) {
  const [since, now] = [axis.since_ns, nowOf(axis)];
  return since === null || isDate(since) !== isDate(now) ? "" : "for " + span(Math.max(0, now - since) / 1e9);
}

// Seconds as a person says them.
function span(seconds) {
  const units = [["days", 86400], ["hours", 3600], ["minutes", 60]];
  const [name, size] = units.find(([, length]) => seconds >= 2 * length) || ["seconds", 1];
  return Math.round(seconds / size) + " " + name;
}

// A text of which what stands between backticks is a command.
function say(element, text) {
  element.replaceChildren(...text.split("`").map((part, index) => {
    if (index % 2 === 0) return part;
    const code = document.createElement("code");
    code.textContent = part;
    return code;
  }));
}

function make(tag, text, name) {
  const element = document.createElement(tag);
  element.textContent = text;
  if (name) element.className = name;
  return element;
}

function rows(table, entries) {
  table.replaceChildren(...entries.map(([name, value, bad]) => {
    const row = document.createElement("tr"), head = make("th", name);
    head.scope = "row";
    row.append(head, make("td", value, bad ? "bad" : ""));
    return row;
  }));
}

// ---- what the daemon says

function listen() {
  if (stream) stream.close();
  live = [];
  stream = new EventSource("/api/v1/events" + (chosen ? "?axis=" + encodeURIComponent(chosen) : ""));
  stream.addEventListener("open", () => { linked(true); recall(); refresh(); });
  stream.addEventListener("error", () => { linked(false); ask("/api/v1/reasons"); });
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
  byId("link").textContent = good ? "connected" : "connection to seepd lost: what is shown is old";
  byId("link").classList.toggle("lost", !good);
}

// What the daemon answers; nothing where it does not, which the stream tells. Who is not let in any more is led to the login form.
async function ask(place) {
  try {
    const answer = await fetch(place);
    if (answer.status === 401) location.reload();
    return answer.ok ? await answer.json() : null;
  } catch { return null; }
}

function choose(axis) {
  chosen = axis;
  cycles = []; trend = []; healthy = null; phases = []; view = null; readAt = { trend: null, cycle: null };
  listen();
  // What was drawn is another axis's, and this one may be silent.
  draw();
  if (status) show(status);
}

let isRefreshing = false, isOld = false;
// One question at a time: a press in a hurry has many cycles a second.
async function refresh() {
  if (!chosen) return;
  if (isRefreshing) { isOld = true; return; }
  isRefreshing = true;
  const of = chosen, place = "/api/v1/axes/" + encodeURIComponent(of);
  const [newCycles, newTrend, course] = await Promise.all(["/cycles", "/trend", "/healthy"].map((word) => ask(place + word)));
  if (of === chosen) {
    cycles = newCycles || cycles; trend = newTrend || trend;
    if (course) { healthy = course.healthy.cycles ? course.healthy : null; phases = course.phases; }
    drawCycle(); drawTrend();
  }
  setTimeout(() => { isRefreshing = false; if (isOld || of !== chosen) { isOld = false; refresh(); } }, 500);
}

function show(overview) {
  status = overview;
  const names = overview.axes.map((axis) => axis.axis);
  if (!chosen || !names.includes(chosen)) {
    if (names.length) choose(names[0]);
    return;
  }
  showOverview(overview);
  const axis = axisNow();
  showCondition(axis);
  showSource(axis);
  showRepairs(axis);
  rows(byId("sinks"), overview.sinks.length ? overview.sinks.map((sink) => {
    const counts = sink.sent + " sent, " + sink.waiting + " waiting, " + sink.dropped + " dropped";
    return [sink.name, sink.detail + " · " + counts, !sink.good];
  }) : [["none", "no sink is configured"]]);
  document.title = FLAGS[axis.flag] + " · " + axis.axis + " · seepd";
  byId("footer").textContent = "seepd " + overview.version + " · run " + overview.run + " · " +
    (overview.time ? new Date(overview.time).toLocaleString() : "the clock of this gateway is not set");
}

// All machines, where there are several. The buttons stay the same, so that one that has the focus keeps it.
function showOverview(overview) {
  const nav = byId("overview");
  nav.hidden = overview.axes.length < 2;
  if (nav.children.length !== overview.axes.length) {
    nav.replaceChildren(...overview.axes.map(() => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(make("span", "", "name"), document.createElement("strong"), make("span", "", "more"));
      button.addEventListener("click", () => choose(button.dataset.axis));
      return button;
    }));
  }
  overview.axes.forEach((axis, index) => {
    const button = nav.children[index], [name, flag, more] = button.children;
    button.dataset.axis = axis.axis;
    button.style.setProperty("--state", "var(--" + axis.flag + ")");
    button.setAttribute("aria-pressed", axis.axis === chosen);
    name.textContent = axis.axis;
    flag.textContent = FLAGS[axis.flag];
    const latched = axis.latched && !axis.acknowledged && axis.latched !== axis.flag ? "was " + FLAGS[axis.latched] + ", not acknowledged" : "";
    const size = axis.flag === "no_estimate" ? told(axis.reason) : axis.leak_flow_lpm === null ? "" : number(axis.leak_flow_lpm) + " L/min";
    more.textContent = [size, howLong(axis), latched].filter(Boolean).join(" · ");
  });
  byId("machine").textContent = chosen;
}

// ---- the answer in ten seconds

function showCondition(axis) {
  const known = axis.flag !== "no_estimate";
  byId("condition").style.setProperty("--state", "var(--" + axis.flag + ")");
  byId("flag").textContent = FLAGS[axis.flag];
  byId("verdict").textContent = axis.verdict;
  say(byId("todo"), axis.to_do);
  // What was seen in the command; what to do about it stands above.
  say(byId("advice"), (axis.advice || "").replace(axis.to_do, "").trim());
  showWhy(axis);
  byId("flow").textContent = known ? number(axis.leak_flow_lpm) : "–";
  byId("interval").textContent = sizeText(axis, known);
  byId("since").textContent = axis.since_ns === null ? "it was first watched"
    : [moment(axis.since_ns), howLong(axis)].filter(Boolean).join(", ");
  byId("part").textContent = partText(axis);
  byId("until").textContent = untilText(axis);
  byId("cost").textContent = !known || axis.leak_power_w === undefined ? "–"
    : number(axis.leak_power_w) + " W, " + Math.round(axis.leak_energy_kwh_per_year) + " kWh a year"
      + (axis.leak_cost_per_year ? ", " + Math.round(axis.leak_cost_per_year.amount) + " " + axis.leak_cost_per_year.currency + " a year" : "");
  byId("baseline").textContent = allBaselines(axis);
  byId("renew").hidden = !axis.baseline.learned_cycles || Boolean(axis.baseline.learning);
  const isOpen = axis.latched && !axis.acknowledged;
  byId("acknowledge").hidden = !isOpen;
  byId("latched").textContent = isOpen ? "Highest flag so far: " + FLAGS[axis.latched] + ". Nobody has acknowledged it." : "";
  const by = axis.acknowledgement;
  byId("acknowledged").hidden = !axis.acknowledged;
  byId("acknowledged").textContent = axis.acknowledged
    ? "Highest flag so far: " + FLAGS[axis.latched] + ", acknowledged" + (by ? by_text(by) + ", " + moment(by.t_ns) : "") + "." : "";
}

const by_text = (by) => (by.who ? " by " + by.who : "") + (by.note ? " (" + by.note + ")" : "");

function showWhy(axis) {
  const reason = reasons[axis.reason];
  byId("why").hidden = !reason;
  if (reason) { say(byId("cause"), reason.cause); say(byId("check"), reason.check); }
}

function sizeText(axis, known) {
  if (axis.relative) return "An axis without a model tells no sizes.";
  if (!known) return axis.leak_flow_lpm === null ? "" : "last known: " + number(axis.leak_flow_lpm) + " L/min";
  if (!axis.interval90_m2) return "";
  const [low, high] = axis.interval90_m2;
  return number(flowOf(axis, low)) + " … " + number(flowOf(axis, high)) + " L/min at " + axis.reference_dp_pa / 1e5 + " bar, nine times in ten; an area of "
    + mm2(axis.leak_area_m2) + " mm²";
}

// When a condition began; growth and what to do are in its sentence.
const sinceText = (one) => " " + spaced(one.cause) + (one.manner === "drift" ? " growing" : "") + " since about " + moment(one.onset_ns)
  + " (" + moment(one.onset_range_ns[0]) + " … " + moment(one.onset_range_ns[1]) + ")" + (one.severity === "slight" ? ", slight so far." : ", large enough to matter.");

function partText(axis) {
  const beside = axis.condition ? "Beside the seal: " + axis.condition + axis.conditions.map(sinceText).join("") : "";
  if (axis.relative) return axis.relative.changed ? "The command has changed in " + axis.relative.features.slice(0, 4).map(spaced).join(", ") : "–";
  const isSeal = ["watch", "leak", "severe"].includes(axis.flag);
  return [isSeal ? "The piston seal." : "", beside].filter(Boolean).join(" ") || (axis.flag === "healthy" ? "None." : "–");
}

function untilText(axis) {
  if (["leak", "severe"].includes(axis.flag)) return "It is time now.";
  if (axis.flag === "no_estimate") return "–";
  const range = axis.time_to_leak_range_s;
  if (!axis.time_to_leak_s || !range) return axis.baseline.learned_cycles ? "No growth is certain." : "–";
  const at = (seconds) => isDate(nowOf(axis)) && seconds > 2 * 86400
    ? new Date(nowOf(axis) / 1e6 + seconds * 1000).toLocaleDateString(undefined, { dateStyle: "medium" }) : "in " + span(seconds);
  return "The flag “leak” is to be expected: " + at(axis.time_to_leak_s) + " (" + at(range[0]) + " … " + at(range[1]) + ").";
}

const FINDINGS = { none: "no change", leak: "more leakage than then", improved: "less leakage than then; learn a new baseline" };

const baselineText = ({ learned_cycles: cycles, occasion, learning }) =>
  learning ? "learning the healthy machine: " + learning[0] + " of " + learning[1] + " cycles"
    : cycles ? "its own baseline of " + cycles + " cycles (" + spaced(occasion) + ")" : "no baseline: the estimate is that of the model alone";

function allBaselines(axis) {
  if (axis.duty_cycles) {
    return axis.duty_cycles.map((one) => one.name + " (" + one.cycles + " cycles): " + baselineText(one.baseline)).join("; ")
      + (axis.finding === "none" ? "" : " – " + FINDINGS[axis.finding]);
  }
  const changed = axis.relative?.changed ? "it has changed" : FINDINGS[axis.finding];
  return baselineText(axis.baseline) + (axis.baseline.learned_cycles && !axis.baseline.learning ? ": " + changed : "");
}

// ---- lists

const VERDICTS = { not_seen: "not seen", borne_out: "borne out", contradicted: "contradicted" };

function showRepairs(axis) {
  const items = [...axis.repairs].reverse().map((done) => {
    const said = [done.who, done.note].filter(Boolean).join(": ");
    return make("li", moment(done.t_ns) + " · " + spaced(done.what) + (said ? " (" + said + ")" : "") + " · "
      + (done.text || (done.verdict ? VERDICTS[done.verdict] : "too few cycles yet")), done.verdict === "contradicted" ? "severe" : "");
  });
  byId("repairs").replaceChildren(...(items.length ? items : [make("li", "none", "none")]));
}

const STATES = { waiting: "nothing has come yet", receiving: "receiving", silent: "silent: no command comes", down: "down", ended: "the log has been read" };

function showSource(axis) {
  const source = axis.source, entries = [
    [source.name || "–", STATES[source.state] + (source.detail ? " · " + source.detail : ""), axis.stale || source.state === "down"],
    ["frames, samples", source.frames + ", " + source.samples],
    ["cycles used", axis.cycles],
  ];
  const counts = {
    "dropped by the kernel": source.dropped_in_socket, "missing by their counter": source.missing_by_counter,
    "repeated counters": source.repeated, "counter jumps": source.counter_jumps, "malformed frames": source.malformed,
    "frames too short": source.too_short, "error frames": source.error, "remote frames": source.remote, "opened again": source.reopened,
  };
  for (const [name, count] of Object.entries(counts)) if (count) entries.push([name, count]);
  for (const [reason, count] of Object.entries(axis.rejected)) entries.push(["cycles without an estimate: " + told(reason), count]);
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
  const before = new Set(events), history = (await ask("/api/v1/history"))?.reverse();
  if (!history) return;
  const known = new Set(history.map((event) => event.id));
  const others = events.filter((event) => !known.has(event.id));
  events = [...others.filter((event) => !before.has(event)), ...history, ...others.filter((event) => before.has(event))];
  showEvents();
}

function showEvents() {
  events = events.slice(0, EVENTS);
  if (events.length) byId("events").replaceChildren(...events.map(eventItem));
}

function eventItem(event) {
  const what = {
    "seepd.event/1": () => FLAGS[event.flag_from] + " → " + FLAGS[event.flag_to] + ": " + (event.evidence.reason ? told(event.evidence.reason) : event.text),
    "seepd.notice/1": () => event.text,
    "seepd.acknowledged/1": () => "acknowledged" + (event.latched ? ": " + FLAGS[event.latched] : "") + by_text(event),
    "seepd.test/1": () => "test alarm",
  }[event.schema];
  const item = make("li", "", event.flag_to || ""), time = make("time", event.published_at ? moment(Date.parse(event.published_at) * 1e6) : "clock not set");
  item.append(time, " · " + event.axis + " · " + (what ? what() : event.schema));
  return item;
}

function showCycleList() {
  byId("cycle-list").replaceChildren(...[...cycles].reverse().map((cycle) => make("li", "cycle " + cycle.cycle + " · "
    + (cycle.reason ? "no estimate: " + told(cycle.reason) : number(cycle.leak_flow_lpm) + " L/min · " + FLAGS[cycle.flag]), cycle.flag)));
}

// ---- drawing

const LEFT = 46, RIGHT = 8, TOP = 8, BOTTOM = 22;

// Axes with ticks, and a way from values to places on the canvas and back.
function plane(canvas, x, y, { logarithmic = false, xTicks = null } = {}) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.font = "12px system-ui, sans-serif";
  const up = logarithmic ? Math.log10 : (value) => value;
  const placeX = (value) => LEFT + (value - x[0]) / (x[1] - x[0]) * (width - LEFT - RIGHT);
  const placeY = (value) => height - BOTTOM - (up(value) - up(y[0])) / (up(y[1]) - up(y[0])) * (height - TOP - BOTTOM);
  pen.strokeStyle = color("line"); pen.fillStyle = color("soft"); pen.lineWidth = 1;
  pen.textAlign = "right"; pen.textBaseline = "middle";
  for (const value of logarithmic ? decades(y) : ticks(y, 5)) {
    pen.beginPath(); pen.moveTo(LEFT, placeY(value)); pen.lineTo(width - RIGHT, placeY(value)); pen.stroke();
    pen.fillText(String(Number(value.toPrecision(3))), LEFT - 6, placeY(value));
  }
  pen.textBaseline = "top";
  for (const [value, name] of xTicks || ticks(x, width > 600 ? 8 : 5).map((value) => [value, String(Number(value.toPrecision(6)))])) {
    pen.textAlign = placeX(value) > width - 30 ? "right" : "center";
    pen.fillText(name, Math.min(placeX(value), width - RIGHT), height - BOTTOM + 5);
  }
  const value = (pixel) => x[0] + (pixel - LEFT) / (width - LEFT - RIGHT) * (x[1] - x[0]);
  return { pen, placeX, placeY, value, width, height, line(points, style, { thickness = 1.5, dash = [] } = {}) {
    pen.strokeStyle = style; pen.lineWidth = thickness; pen.setLineDash(dash); pen.beginPath();
    points.forEach(([a, b], index) => index ? pen.lineTo(placeX(a), placeY(b)) : pen.moveTo(placeX(a), placeY(b)));
    pen.stroke(); pen.setLineDash([]);
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
  pen.fillStyle = color("soft"); pen.textAlign = "center"; pen.font = "15px system-ui, sans-serif";
  pen.fillText(text, canvas.clientWidth / 2, canvas.clientHeight / 2);
  canvas.picture = null;
}

function drawLive() {
  if (live.length < 2) return empty(byId("live"), "no command yet");
  const newest = live[live.length - 1][0];
  const points = live.map(([t, command]) => [(t - newest) / 1e9, command]);
  plane(byId("live"), [-LIVE_S, 0], range(points.map((point) => point[1]), 0.1)).line(points, color("a"));
}

// Where points stand: by their time, or by number of cycles where the clock was set in between, which is no time at all.
function places(points) {
  const years = 5 * 365 * DAY_NS;
  const stepped = points.some((point, index) => index && (point.t_ns < points[index - 1].t_ns || point.t_ns - points[index - 1].t_ns > years));
  return { byTime: !stepped, at: stepped ? (_, index) => index - points.length + 1 : (point) => point.t_ns };
}

// Round steps of time, named as a person would.
function timeTicks([from, to], width) {
  const steps = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 14400, 28800, 86400, 172800, 604800, 1209600, 2592000, 7776000, 31536000].map((s) => s * 1e9);
  const step = steps.find((step) => (to - from) / step <= width / 110) || (to - from) / 4, all = [];
  const shift = isDate(from) ? new Date(from / 1e6).getTimezoneOffset() * 6e10 : 0;
  for (let at = Math.ceil((from - shift) / step) * step + shift; at <= to; at += step) {
    const date = new Date(at / 1e6);
    all.push([at, !isDate(at) ? number(at / 1e9, 6) + " s" : step >= DAY_NS ? date.toLocaleDateString(undefined, { day: "numeric", month: "short" })
      : date.toLocaleTimeString(undefined, step < 6e10 ? { timeStyle: "medium" } : { timeStyle: "short" })]);
  }
  return all;
}

function drawTrend() {
  const canvas = byId("trend"), axis = axisNow();
  for (const [id, pressed] of [["zoom-all", !view], ["zoom-day", view?.of === "day"], ["zoom-hour", view?.of === "hour"]]) byId(id).setAttribute("aria-pressed", pressed);
  if (!trend.length || !axis || !axis.lpm_per_m2) return empty(canvas, axis?.relative ? "an axis without a model has no sizes" : "no estimate yet");
  const { at, byTime } = places(trend), ends = [at(trend[0], 0), at(trend[trend.length - 1], trend.length - 1)];
  const [from, to] = window_of(ends, byTime);
  const shown = trend.map((point, index) => ({ ...point, x: at(point, index) })).filter(({ x }) => x >= from && x <= to);
  if (!shown.length) return empty(canvas, "no estimate in this stretch");
  const flow = (area) => flowOf(axis, area), { watch_lpm: watch, leak_lpm: leak, severe_lpm: severe } = axis.thresholds;
  const bottom = Math.max(Math.min(...shown.map((point) => flow(point.interval90_m2[0])), watch / 2), 0.01) / 1.2;
  const top = Math.max(...shown.map((point) => flow(point.interval90_m2[1])), leak) * 1.3;
  const picture = plane(canvas, [from, to], [bottom, top], { logarithmic: true, xTicks: byTime ? timeTicks([from, to], canvas.clientWidth) : null });
  const { pen, placeX, placeY, height, width } = picture, clip = (value) => Math.max(value, bottom);
  pen.fillStyle = color("band"); pen.beginPath();
  shown.forEach((point) => pen.lineTo(placeX(point.x), placeY(clip(flow(point.interval90_m2[1])))));
  [...shown].reverse().forEach((point) => pen.lineTo(placeX(point.x), placeY(clip(flow(point.interval90_m2[0])))));
  pen.fill();
  picture.line(shown.map((point) => [point.x, clip(point.leak_flow_lpm)]), color("a"), { thickness: 2 });
  pen.textAlign = "left"; pen.textBaseline = "bottom";
  for (const [name, limit] of [["watch", watch], ["leak", leak], ["severe", severe]]) {
    if (limit > top) continue;
    picture.line([[from, limit], [to, limit]], color(name), { thickness: 1.2, dash: [6, 4] });
    const words = name + " from " + limit + " L/min";
    // The curve may pass behind the words.
    pen.strokeStyle = color("panel"); pen.lineWidth = 4; pen.strokeText(words, LEFT + 6, placeY(limit) - 2);
    pen.fillStyle = color(name); pen.fillText(words, LEFT + 6, placeY(limit) - 2);
  }
  // What it was taken for, along the foot.
  shown.forEach((point, index) => {
    const next = shown[index + 1];
    pen.fillStyle = color(point.flag);
    pen.fillRect(placeX(point.x), height - BOTTOM - 4, Math.max(1.5, next ? placeX(next.x) - placeX(point.x) + 0.5 : 2), 4);
  });
  const labelled = [-1e9, -1e9, -1e9];
  marks(axis).forEach(({ t_ns, name, bold }) => {
    const mark = shown.find((point) => point.t_ns >= t_ns);
    if (!mark || t_ns < shown[0].t_ns) return;
    picture.line([[mark.x, bottom], [mark.x, top]], color("text"), { thickness: bold ? 2 : 1, dash: bold ? [] : [4, 3] });
    const right = placeX(mark.x) > width - 110;
    // Names that would cover each other are left out; the readout and the list below have them.
    const row = labelled.findIndex((x) => Math.abs(placeX(mark.x) - x) > 110);
    if (row < 0) return;
    labelled[row] = placeX(mark.x);
    pen.fillStyle = color("text"); pen.textAlign = right ? "right" : "left"; pen.textBaseline = "top";
    pen.fillText(name, placeX(mark.x) + (right ? -5 : 5), TOP + 14 * row);
  });
  canvas.picture = { ...picture, points: shown, ends, byTime, shown: [from, to] };
  readTrend();
}

// New seals and other repairs, and baselines.
function marks(axis) {
  const learned = events.filter((event) => event.axis === chosen && event.notice === "baseline_learned");
  return [...axis.repairs.map((done) => ({ t_ns: done.t_ns, name: done.what === "seal_replaced" ? "new seal" : spaced(done.what), bold: done.what === "seal_replaced" })),
    ...learned.map((event) => ({ t_ns: event.t_ns, name: "baseline", bold: false }))].sort((a, b) => a.t_ns - b.t_ns);
}

function window_of([first, last], byTime) {
  const least = byTime ? 1e9 : 2;
  if (!view || (view.of && !byTime)) return [first, Math.max(last, first + least)];
  if (view.of) return [last - (view.of === "day" ? DAY_NS : HOUR_NS), last];
  return [view.from, Math.max(view.to, view.from + least)];
}

function zoom(factor) {
  const picture = byId("trend").picture;
  if (!picture) return;
  const [from, to] = picture.shown, [first, last] = picture.ends;
  const middle = readAt.trend === null ? to - (to - from) / 2 : readAt.trend, half = (to - from) / 2 * factor;
  const next = { from: Math.max(first, middle - half), to: Math.min(last, middle + half) };
  view = next.from <= first && next.to >= last ? null : next;
  drawTrend();
}

function nearest(points, x) {
  return points.reduce((best, point) => Math.abs(point.x - x) < Math.abs(best.x - x) ? point : best, points[0]);
}

function cross({ pen, placeX, placeY, height }, x, y, style) {
  pen.strokeStyle = color("soft"); pen.lineWidth = 1; pen.beginPath(); pen.moveTo(placeX(x), TOP); pen.lineTo(placeX(x), height - BOTTOM); pen.stroke();
  pen.fillStyle = style; pen.beginPath(); pen.arc(placeX(x), placeY(y), 4, 0, 7); pen.fill();
}

function readTrend() {
  const canvas = byId("trend"), picture = canvas.picture, axis = axisNow();
  if (!picture || readAt.trend === null) return;
  const point = nearest(picture.points, readAt.trend), [low, high] = point.interval90_m2.map((area) => flowOf(axis, area));
  cross(picture, point.x, point.leak_flow_lpm, color("a"));
  byId("trend-readout").textContent = moment(point.t_ns) + ": " + number(point.leak_flow_lpm) + " L/min (" + number(low) + " … " + number(high) + "), "
    + mm2(point.leak_area_m2) + " mm², " + FLAGS[point.flag];
}

const courseAt = (points, t) => {
  const after = points.findIndex((point) => point[0] >= t);
  if (after < 1) return after === 0 && points[0][0] === t ? points[0][1] : null;
  const [[a, u], [b, v]] = [points[after - 1], points[after]];
  return u + (v - u) * (t - a) / (b - a);
};

function drawCycle() {
  showCycleList();
  const canvas = byId("cycle");
  const cycle = [...cycles].reverse().find((cycle) => cycle.points.length > 1 && (!healthy || (cycle.duty_cycle || null) === (healthy.duty_cycle || null)));
  const all = [...(cycle?.points || []), ...(healthy?.points || [])];
  showPhases(cycle);
  byId("cycle-title").textContent = (cycle ? "number " + cycle.cycle + (cycle.reason ? ", no estimate: " + told(cycle.reason) : "") + "; " : "")
    + (healthy ? "healthy: mean of " + healthy.cycles + " cycles from " + moment(healthy.since_ns) + "; " : cycle ? "what a healthy one is like is not known yet; " : "") + "valve command, share of full command";
  byId("cycle-key").hidden = !cycle || !healthy;
  if (!all.length) return empty(canvas, "no cycle yet");
  const end = Math.max(...all.map((point) => point[0])), y = range(all.map((point) => point[1]), 0.1);
  const picture = plane(canvas, [0, end], y), { pen, placeX, height } = picture;
  phases.forEach((phase, index) => {
    const [from, to] = [placeX(phase.from_s), placeX(Math.min(phase.to_s, end))];
    if (index % 2) { pen.globalAlpha = 0.35; pen.fillStyle = color("line"); pen.fillRect(from, TOP, to - from, height - TOP - BOTTOM); pen.globalAlpha = 1; }
    const name = spaced(phase.name);
    if (pen.measureText(name).width < to - from - 4) { pen.fillStyle = color("soft"); pen.textAlign = "center"; pen.textBaseline = "top"; pen.fillText(name, (from + to) / 2, TOP + 2); }
  });
  if (healthy) picture.line(healthy.points, color("a"), { dash: [6, 3] });
  if (cycle) picture.line(cycle.points, cycle.reason ? color("no_estimate") : color("b"), { thickness: 2 });
  canvas.picture = { ...picture, cycle, end };
  readCycle();
}

function readCycle() {
  const picture = byId("cycle").picture, t = readAt.cycle;
  if (!picture || t === null) return;
  const now = picture.cycle ? courseAt(picture.cycle.points, t) : null, then = healthy ? courseAt(healthy.points, t) : null;
  if (now === null && then === null) return;
  cross(picture, t, now ?? then, color("b"));
  const percent = (value) => value === null ? "–" : (100 * value).toFixed(2) + " %";
  byId("cycle-readout").textContent = t.toFixed(2) + " s: " + percent(now) + (then === null || now === null ? "" : ", healthy " + percent(then) + ", difference " + percent(now - then));
}

// The difference by phase: of the command, and of the leak that the model makes of it.
function showPhases(cycle) {
  const table = byId("phases"), why = new Map(cycle?.why || []);
  const mean = (points, from, to) => {
    const within = points.filter(([t]) => t >= from && t < to);
    return within.length ? within.reduce((sum, point) => sum + point[1], 0) / within.length : null;
  };
  const entries = !cycle || !healthy ? [] : phases.map(({ name, from_s, to_s }) => {
    const now = mean(cycle.points, from_s, to_s), then = mean(healthy.points, from_s, to_s);
    return { name, change: now === null || then === null ? null : now - then, area: why.get(name) };
  });
  if (why.has("load")) entries.push({ name: "load", change: null, area: why.get("load") });
  if (!entries.length) return table.replaceChildren();
  const head = document.createElement("tr");
  head.append(...["phase", "command, %", "", "leak, mm²"].map((text, index) => { const cell = make("th", text, index % 2 ? "number" : ""); cell.scope = "col"; return cell; }));
  const largest = Math.max(...entries.map(({ change }) => Math.abs(change || 0)), 5e-3);
  table.replaceChildren(head, ...entries.map(({ name, change, area }) => {
    const row = document.createElement("tr"), first = make("th", spaced(name)), track = make("td", "", "track"), bar = make("span", "", "bar"), ink = document.createElement("i");
    first.scope = "row";
    const share = 50 * Math.abs(change || 0) / largest;
    ink.style.left = (change < 0 ? 50 - share : 50) + "%"; ink.style.width = share + "%";
    bar.append(ink); track.append(bar);
    row.append(first, make("td", change === null ? "–" : (change < 0 ? "−" : "+") + Math.abs(100 * change).toFixed(2), "number"), track,
      make("td", area === undefined ? "–" : (area < 0 ? "−" : "+") + Math.abs(1e6 * area).toFixed(4), "number"));
    return row;
  }));
}

// ---- what a person does

// Pointer and keys read a picture: `step` is how far an arrow goes.
function readable(canvas, key, draw, step, keys = {}) {
  const read = (x) => { readAt[key] = x; draw(); };
  let dragged = null;
  canvas.addEventListener("pointerdown", (event) => { if (event.pointerType === "mouse" && keys.drag) dragged = event.offsetX; });
  canvas.addEventListener("pointermove", (event) => { if (canvas.picture) read(canvas.picture.value(event.offsetX)); });
  canvas.addEventListener("pointerup", (event) => {
    if (dragged !== null && Math.abs(event.offsetX - dragged) > 12 && canvas.picture) keys.drag(...[dragged, event.offsetX].sort((a, b) => a - b).map(canvas.picture.value));
    else if (canvas.picture) read(canvas.picture.value(event.offsetX));
    dragged = null;
  });
  canvas.addEventListener("keydown", (event) => {
    if (!canvas.picture) return;
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (way) read(step(canvas.picture, way));
    else if (keys[event.key]) keys[event.key]();
    else return;
    event.preventDefault();
  });
}

const showAll = () => { view = null; drawTrend(); };
readable(byId("trend"), "trend", drawTrend, ({ points }, way) => {
  const now = readAt.trend === null ? points.length : points.indexOf(nearest(points, readAt.trend));
  return points[Math.min(Math.max(now + way, 0), points.length - 1)].x;
}, { "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), 0: showAll, Escape: showAll, drag: (from, to) => { view = { from, to }; drawTrend(); } });
readable(byId("cycle"), "cycle", drawCycle, ({ end }, way) => Math.min(Math.max((readAt.cycle ?? 0) + way * end / 100, 0), end));
byId("zoom-all").addEventListener("click", showAll);
byId("zoom-day").addEventListener("click", () => { view = { of: "day" }; drawTrend(); });
byId("zoom-hour").addEventListener("click", () => { view = { of: "hour" }; drawTrend(); });
byId("zoom-in").addEventListener("click", () => zoom(0.5));
byId("zoom-out").addEventListener("click", () => zoom(2));

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

byId("acknowledge").addEventListener("submit", async (event) => {
  event.preventDefault();
  const by = { who: byId("acknowledge-who").value, note: byId("acknowledge-note").value };
  if (await order("acknowledge", JSON.stringify(by))) byId("acknowledge-note").value = "";
});
byId("renew").addEventListener("click", () => {
  const question = "Is the machine healthy now? A new baseline will be learned from the next cycles, with whatever leaks; the old one is kept as a record.";
  if (confirm(question)) order("new-baseline");
});
byId("repair").addEventListener("submit", async (event) => {
  event.preventDefault();
  const entry = { what: byId("repair-what").value, who: byId("repair-who").value, note: byId("repair-note").value };
  if (await order("repairs", JSON.stringify(entry))) byId("repair-note").value = "";
});

function draw() { drawLive(); drawCycle(); drawTrend(); }

addEventListener("resize", draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
draw();
listen();
ask("/api/v1/reasons").then((all) => {
  reasons = Object.fromEntries((all || []).map((reason) => [reason.name, reason]));
  if (status) show(status);
});
