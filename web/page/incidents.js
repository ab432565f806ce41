// Incidents: a card each; its picture and its story are fetched when it is opened.
const $ = (id) => document.getElementById(id);
const LATER_MS = 4000; // a stop's file is written some seconds after it
const cards = new Map(); // one that is open stays open
let shown = "", last = 0;

function node(kind, content, more) {
  return Object.assign(document.createElement(kind), {textContent: content}, more);
}

async function open(card, identity) {
  if (card.dataset.open) return;
  card.dataset.open = "1";
  const picture = node("img", "", {src: `/api/incidents/${identity}/picture`, alt: "The seconds around the stop"});
  const none = "No picture: that needs matplotlib on the robot.";
  picture.onerror = () => picture.replaceWith(node("p", none, {className: "dim"}));
  const link = node("a", "", {href: picture.src, target: "_blank", rel: "noopener"});
  link.append(picture);
  const list = node("ol", "");
  card.append(link, list);
  const answer = await fetch(`/api/incidents/${identity}/story`);
  const {story = []} = answer.ok ? await answer.json() : {};
  list.replaceChildren(...story.map(({ms, what, text}) => {
    const row = node("li", "", {className: what === "CAUSE" ? "cause" : ""});
    row.append(node("i", `${ms > 0 ? "+" : ""}${ms.toFixed(1)} ms`), node("span", text));
    return row;
  }));
}

function card({id, t, reason, proof}) {
  const found = cards.get(id) || node("details", "", {className: "card"});
  if (!cards.has(id)) {
    cards.set(id, found);
    found.append(node("summary", ""));
    found.addEventListener("toggle", () => { if (found.open) open(found, id); });
  }
  const when = new Date(t * 1000).toLocaleString([], {dateStyle: "medium", timeStyle: "medium"});
  found.firstChild.replaceChildren(node("b", reason), node("small", `${when}: ${proof}`));
  return found;
}

async function look() {
  const answer = await fetch("/api/incidents").catch(() => null);
  if (!answer || !answer.ok) return;
  const text = await answer.text();
  if (text === shown) return;
  shown = text;
  const {incidents} = JSON.parse(text);
  $("incidents").replaceChildren(...incidents.map((incident) => card(incident)));
  if (!incidents.length) $("incidents").replaceChildren(node("p", "none", {className: "dim"}));
}

addEventListener("face", ({detail}) => {
  const newest = detail.events.findLast(({kind}) => kind === "incident");
  if (newest && newest.seq !== last) { last = newest.seq; look(); setTimeout(look, LATER_MS); }
});
addEventListener("link-open", look);
look();
