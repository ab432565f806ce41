// Incidents: a card for each. Opening a card requests its picture and its story again and again, until both exist.
import {inTurn} from "/link.js";

const $ = (id) => document.getElementById(id);
const AGAIN_MS = 1000, LATER_MS = 4000; // the file of a stop is written some seconds after the stop
const FIRST = 5; // older incidents are shown after a touch
const cards = new Map(); // kept, so that an open card stays open
const rest = node("details", ""), restName = node("summary", "");
let shown = "", last = "";

function node(kind, content, more) {
  return Object.assign(document.createElement(kind), {textContent: content}, more);
}

async function ask(path, signal) {
  const answer = await fetch(path, {cache: "no-store", signal});
  if (answer.status === 404) return {story: [], picture: false};
  return answer.ok ? answer.json() : {};
}

function draw(picture, src, signal) {
  return new Promise((done, failed) => {
    Object.assign(picture, {src, onload: done, onerror: failed});
    signal.addEventListener("abort", () => { picture.removeAttribute("src"); failed(); });
  });
}

async function open(card, identity) {
  if (card.dataset.open) return;
  card.dataset.open = "1";
  const base = `/api/incidents/${identity}`, list = node("ol", ""), wait = node("p", "Drawing the picture ...", {className: "dim"});
  card.append(wait, list);
  for (let whole = false; !whole; await new Promise((go) => setTimeout(go, AGAIN_MS))) {
    if (!card.open) continue; // request nothing for a closed card
    const {story, picture} = await inTurn((signal) => ask(`${base}/story`, signal)).catch(() => ({}));
    if (story && !list.childElementCount) list.replaceChildren(...story.map(line));
    if (picture) whole = await inTurn((signal) => show(wait, `${base}/picture`, signal)).then(() => true, () => false);
    else if (picture === false) { whole = true; wait.textContent = "There is no picture, because the robot lacks matplotlib or room on its disk."; }
  }
}

async function show(place, src, signal) {
  const picture = node("img", "", {alt: "The seconds around the stop"});
  await draw(picture, src, signal);
  const link = node("a", "", {href: src, target: "_blank", rel: "noopener"});
  link.append(picture);
  place.replaceWith(link);
}

function line({ms, what, text}) {
  const row = node("li", "", {className: what === "CAUSE" ? "cause" : ""});
  row.append(node("i", `${ms > 0 ? "+" : ""}${ms.toFixed(1)} ms`), node("span", text));
  return row;
}

function card({id, t, reason, proof}) {
  const found = cards.get(id) || node("details", "", {className: "card"});
  if (!cards.has(id)) {
    cards.set(id, found);
    found.append(node("summary", ""));
    found.addEventListener("toggle", () => { if (found.open) open(found, id); });
  }
  const when = new Date(t * 1000).toLocaleString([], {dateStyle: "medium", timeStyle: "medium", hourCycle: "h23"});
  found.firstChild.replaceChildren(node("b", reason), node("small", `${when}: ${proof}`));
  return found;
}

async function look() {
  const text = await inTurn((signal) => fetch("/api/incidents", {signal}).then((answer) => answer.ok && answer.text()))
    .catch(() => { setTimeout(look, LATER_MS); });
  if (!text || text === shown) return;
  shown = text;
  const {incidents} = JSON.parse(text);
  const made = incidents.map((incident) => card(incident)), older = made.slice(FIRST);
  restName.textContent = `${older.length} older`;
  arrange(rest, [restName, ...older]);
  if (!made.length) $("incidents").replaceChildren(node("p", "none", {className: "dim"}));
  else arrange($("incidents"), [...made.slice(0, FIRST), ...(older.length ? [rest] : [])]);
}

// Like replaceChildren, but what stays where it is keeps the focus of the keyboard: a new incident comes at any time.
function arrange(place, wanted) {
  for (const child of [...place.children]) if (!wanted.includes(child)) child.remove();
  wanted.forEach((child, at) => { if (place.children[at] !== child) place.insertBefore(child, place.children[at] || null); });
}

addEventListener("view", ({detail}) => {
  const newest = detail.events.findLast(({kind}) => kind === "incident");
  const found = newest ? `${detail.run} ${newest.seq} ${newest.t}` : ""; // each run numbers its events from the beginning
  if (found && found !== last) { look(); setTimeout(look, LATER_MS); }
  last = found;
});
addEventListener("link-open", look);
look();
