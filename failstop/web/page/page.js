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
const STALE_MS = 1000; // after this long without a message, the last state is shown as old
const REST_MS = 300;
const charts = {speed: new Chart($("speed-chart"), 0.2), shake: new Chart($("shake-chart"), 10)};
const drawSeldom = seldom(drawLive);
const drawn = {}; // the content of each list, which is rebuilt only when that changes, because each rebuild costs a layout
let view = null, live = null, paired = false, drives = false, heard = -Infinity, behind = 0, before = 0, earlier = undefined, own = null, waits = false, spoken = "";

function text(id, value) {
  if ($(id).textContent !== value) $(id).textContent = value;
}

function clock(unix) {
  return new Date(unix * 1000).toLocaleTimeString([], {hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23"});
}

function ago(unix) {
  const seconds = Math.max(0, Date.now() / 1000 + behind - unix);
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
  // Whether this touch has latched it. Without a view from before the touch, only the times can show it.
  const first = own.earlier === undefined ? stop.t >= own.asked - 0.5 : stop.id !== own.earlier;
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
  const known = view.events.findIndex(({seq, t}) => seq === newest[0] && t === newest[1]);
  if (known < 0) rows.replaceChildren();
  rows.prepend(...view.events.slice(known + 1).reverse().map(({t, level, text: said}) => {
    const row = document.createElement("li");
    row.dataset.level = level;
    row.append(node("time", clock(t)), node("span", said));
    return row;
  }));
  while (rows.childElementCount > view.events.length) rows.lastChild.remove();
  const last = view.events.at(-1);
  drawn.events = last && [last.seq, last.t];
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
  const steered = live && live[5] ? `, steered ${live[5]}` : "", silent = view && !view.imu ? "no IMU" : "IMU silent";
  text("speed", live ? `${speed.toFixed(2)} m/s, ${live[2].toFixed(2)} rad/s${steered}` : "not known");
  if ($("wheels")) text("wheels", seen());
  text("shake", shake === null || shake === undefined ? silent : `${shake.toFixed(1)} mrad/s`);
}

function lost() {
  if (performance.now() - heard < STALE_MS || $("head").dataset.role === "lost") return;
  $("head").dataset.role = "lost";
  $("word").classList.add("long");
  text("word", "NO CONTACT");
  speak("NO CONTACT", "The page gets no news from the robot.");
  text("why", `The page gets no news from the robot.${view ? ` Last known: ${view.word}.` : ""}`);
  text("next", "STOP still tries to reach it. To be sure, use the POWER SWITCH.");
  text("since", "");
  showLive(null);
  drawLive();
}

function news(message) {
  heard = performance.now();
  behind = message.t - Date.now() / 1000;
  if ("nonce" in message || "attend" in message || "drive" in message) dispatchEvent(new CustomEvent("lease", {detail: message}));
  if ("live" in message) showLive(message.live);
  if (message.view) view = message.view;
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
  if (event.detail.view && !(view && event.detail.view.epoch < view.epoch)) { view = event.detail.view; heard = performance.now(); show(); }
});
addEventListener("device", ({detail}) => {
  paired = !!detail.device;
  drives = paired && !!detail.drive;
  if (view && $("head").dataset.role !== "lost") show();
});
setInterval(lost, 200);
connect(news);
