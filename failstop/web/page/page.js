// Page: shows what arrives over the websocket. STOP is in stop.js, and works without this file.
import {Chart, later, seldom} from "/chart.js";
import {connect} from "/link.js";
import "/buttons.js";
import "/device.js";
import "/attend.js";
import "/drive.js";
import "/incidents.js";
import "/view.js";

const $ = (id) => document.getElementById(id);
const STALE_MS = 1000; // a state that may be older than this is not shown as the present one
const REST_MS = 300;
const EARLY_S = 0.5; // how much earlier than its request a stop may seem, by the robot's clock
const TIME_ONLY_S = 12 * 3600; // a time further away than this is shown with its date
const charts = {speed: new Chart($("speed-chart"), 0.2), shake: new Chart($("shake-chart"), 10)};
const drawSeldom = seldom(drawLive);
const drawn = {}; // the content of each list, which is rebuilt only when that changes, because each rebuild costs a layout
let view = null, live = null, paired = false, drives = false, heard = -Infinity, behind = 0, before = 0, earlier = undefined, own = null, waits = false, spoken = "";

function text(id, value) {
  if ($(id).textContent !== value) $(id).textContent = value;
}

function now() {
  return Date.now() / 1000 + behind; // by the robot's clock
}

function dated(unix) {
  return Math.abs(now() - unix) > TIME_ONLY_S;
}

function clock(unix) {
  const at = new Date(unix * 1000);
  if (dated(unix)) return at.toLocaleString([], {dateStyle: "medium", timeStyle: "medium", hourCycle: "h23"});
  return at.toLocaleTimeString([], {hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23"});
}

function ago(unix) {
  const seconds = Math.max(0, now() - unix);
  if (seconds < 120) return `${Math.round(seconds)} s ago`;
  return seconds < 7200 ? `${Math.floor(seconds / 60)} min ago` : `${Math.floor(seconds / 3600)} h ago`;
}

// A screen reader announces a new word with its reason, but none of the values that change all the time.
function speak(word, why) {
  if (spoken === word) return;
  spoken = word;
  text("spoken", `${word}. ${why}`);
}

function show() {
  text("robot", `${view.name || "failstop"} on ${location.hostname}`);
  text("word", view.word);
  $("word").classList.toggle("long", view.word.length > 9);
  $("head").dataset.role = view.role;
  text("why", view.why);
  text("next", !paired ? view.next_unpaired : drives && view.attended !== null ? view.next_driver : view.next);
  speak(view.word, view.why);
  document.title = `${view.word} - failstop`;
  showStop();
  dispatchEvent(new CustomEvent("view", {detail: view}));
  // A finger on STOP waits while the page draws, so the parts that people read but don't watch are drawn when it is idle.
  if (!drawn.facts) showRest(); // the first time at once, so that nothing moves under a finger later
  else if (!waits) { waits = true; later(showRest, {timeout: REST_MS}); }
}

function showRest() {
  waits = false;
  showFacts();
  showEvents();
}

function list(id, content, make) {
  const key = JSON.stringify(content);
  if (drawn[id] === key) return;
  drawn[id] = key;
  $(id).replaceChildren(...content.flatMap(make));
}

function showStop() {
  const stop = view.stop, halt = view.unlatched, known = stop ? `${stop.reason} (${clock(stop.t)})` : "";
  const at = halt && halt.t ? ` (${clock(halt.t)})` : "";
  const last = halt ? `${halt.reason}${at}; ${halt.lacks}` : known || "none since the service was started";
  text("last-reason", halt && stop ? `${last}. The last latched stop was earlier: ${known}` : last);
  $("last-proof").hidden = !stop || !!halt; // the times of an earlier stop say nothing about this one
  if (own) followOwn();
  if (!stop) return;
  for (const item of $("last-proof").children) {
    const level = item.dataset.level, when = stop[level];
    item.classList.toggle("there", !!when);
    const said = level === "observed" ? when : when && `after ${when}`;
    const shown = said || stop.lacks[level] || "not known";
    if (item.dataset.said === shown) continue;
    item.dataset.said = shown;
    item.replaceChildren(level, node("b", shown));
  }
  if (own === null || !view.latched) return;
  // Whether this touch has latched it: only a stop that came after the robot heard of the touch. Without contact, the page may
  // not know an earlier stop.
  if (stop.id !== own.earlier && stop.t >= own.asked - EARLY_S) own.latched = stop.id;
  const first = stop.id === own.latched;
  if (first && !stop.written) {
    text("stop-said", `NOT SENT: use the POWER SWITCH`);
    $("stop").dataset.phase = "failed";
    return;
  }
  const proofs = first ? ["written", "acknowledged", "observed"].filter((proof) => stop[proof]) : ["written"];
  const said = proofs.map((proof) => `\u2713\u00a0${proof}`).join("  ");
  text("stop-said", first ? said : `${said}; a stop was latched already`);
  $("stop").dataset.phase = proofs.at(-1);
}

// A reset ends it, and so does a restart of the service: then another run counts the stops from the beginning. A state from before the
// stop may still arrive after the stop's answer, and does not count.
function followOwn() {
  if (view.latched) Object.assign(own, {epoch: view.epoch, run: view.run});
  else if (view.epoch >= own.epoch || view.epoch < before || (view.run && view.run !== own.run)) {
    own = null;
    dispatchEvent(new Event("unstopped"));
  }
}

function showFacts() {
  const charger = view.plugged === "unknown" ? "" : `, charger ${view.plugged}`;
  const rows = [
    ["Wheels", ""],
    ["Driver", view.driver || "none"],
    ...(view.limit < 100 ? [["Limit", `${view.limit} % of the speeds in the settings`]] : []),
    ["Stops", view.stands],
    ["Battery", view.battery_v ? `${view.battery_v.toFixed(2)} V${charger}${view.battery_age}` : "not known"],
    ["Port", view.port],
    ["Board", view.board],
    ...(view.imu ? [] : [["IMU", "none"]]),
    ["Clients", view.clients.join(", ") || "none"],
  ];
  list("facts", rows, ([name, value]) => {
    const shown = node("dd", value || seen());
    if (!value) shown.id = "wheels"; // it changes all the time
    return [node("dt", name), shown];
  });
  list("troubles", view.troubles, (trouble) => node("li", trouble));
  list("processes", view.processes, ({name, state, restarts}) => {
    const shown = node("li", `${name} ${state}${restarts ? `, restarted ${restarts === 1 ? "once" : `${restarts} times`}` : ""}`);
    shown.classList.toggle("wrong", state !== "running");
    return shown;
  });
}

function seen() {
  return live ? live[6] : "not known";
}

function showEvents() {
  const newest = drawn.events || [], rows = $("events");
  const old = view.events.filter(({t}) => dated(t)).length; // an event gets its date when it becomes old
  const known = old === newest[2] ? view.events.findIndex(({seq, t}) => seq === newest[0] && t === newest[1]) : -1;
  if (known < 0) rows.replaceChildren();
  rows.prepend(...view.events.slice(known + 1).reverse().map(({t, level, text: said}) => {
    const row = document.createElement("li");
    row.dataset.level = level;
    row.append(node("time", clock(t)), node("span", said));
    return row;
  }));
  while (rows.childElementCount > view.events.length) rows.lastChild.remove();
  const last = view.events.at(-1);
  drawn.events = last && [last.seq, last.t, old];
}

function node(kind, content) {
  return Object.assign(document.createElement(kind), {textContent: content});
}

function showLive(values) {
  live = values;
  charts.speed.add(live ? Math.hypot(live[0], live[1]) : null);
  charts.shake.add(live && live[3]);
  drawSeldom();
}

function drawLive() {
  const speed = live && Math.hypot(live[0], live[1]), shake = live && live[3];
  Object.values(charts).forEach((chart) => chart.draw());
  const steered = live && live[5] ? `, steered ${live[5]}` : "", silent = !live ? "not known" : view && !view.imu ? "no IMU" : "IMU silent";
  text("speed", live ? `${speed.toFixed(2)} m/s, ${live[2].toFixed(2)} rad/s${steered}` : "not known");
  if ($("wheels")) text("wheels", seen());
  text("shake", shake === null || shake === undefined ? silent : `${shake.toFixed(1)} mrad/s`);
}

function late() {
  return performance.now() - heard >= STALE_MS;
}

function lost() {
  if (!late()) return;
  text("why", `The page gets no news from the robot in time.${view ? ` Last known: ${view.word}.` : ""}`);
  if ($("head").dataset.role === "lost") return;
  $("head").dataset.role = "lost";
  $("word").classList.add("long");
  text("word", "NO CONTACT");
  document.title = "NO CONTACT - failstop";
  speak("NO CONTACT", "The page gets no news from the robot in time.");
  text("next", "STOP still tries to reach it. To be sure, use the POWER SWITCH.");
  text("since", "");
  showLive(null);
  drawLive();
}

// `since`: the robot has sent this message at this time (performance.now()) or later.
function news(message, since) {
  heard = since;
  behind = message.t - (Date.now() - (performance.now() - since)) / 1000;
  if (["nonce", "attend", "drive"].some((word) => word in message)) {
    dispatchEvent(new CustomEvent("lease", {detail: {...message, late: late()}}));
  }
  if (message.view) view = message.view;
  if ("live" in message) showLive(late() ? null : message.live);
  if (late()) { lost(); return; }
  if (view && (message.view || $("head").dataset.role === "lost")) show();
  if (view) text("since", view.since ? `Since ${clock(view.since)}, ${ago(view.since)}` : "");
}

addEventListener("stopping", () => {
  before = view ? view.epoch : 0;
  earlier = view ? view.stop && view.stop.id : undefined;
});
addEventListener("stopped", (event) => {
  speak("STOP was written", "");
  own = {asked: event.detail.asked, earlier, epoch: before + 1, run: (event.detail.view || view || {}).run};
  const {view: newer, sent} = event.detail; // the answer is not older than the request
  if (!newer || performance.now() - sent >= STALE_MS || (view && newer.epoch < view.epoch)) return;
  view = newer;
  heard = Math.max(heard, sent);
  show();
});
addEventListener("device", ({detail}) => {
  paired = !!detail.device;
  drives = paired && !!detail.drive;
  if (view && $("head").dataset.role !== "lost") show();
});
setInterval(lost, 200);
connect(news);
