// The page around the service: it starts Python, turns switches by its Python's table, lets time pass, shows what that tells.
"use strict";
const $ = (id) => document.getElementById(id);
const LATEST_MS = 50, LOOK_MS = 100, FROM = "https://failstop.invalid/";
let show = null, speed = 1, asked = Promise.resolve();

async function unpack(id) {
  const bytes = Uint8Array.from(atob($(id).textContent), (letter) => letter.charCodeAt(0));
  $(id).remove();
  return new Uint8Array(await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer());
}

async function run(id) {
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(await unpack(id));
  document.head.append(script);
}

// What Python's loader asks for is in the page: nothing is fetched.
async function python() {
  await run("machine");
  await run("pyodide");
  const files = {"pyodide.asm.wasm": [await unpack("wasm"), "application/wasm"], "library.zip": [await unpack("library"), "application/zip"]};
  globalThis.fetch = async (url) => {
    const [data, type] = files[String(url).slice(FROM.length)];
    return new Response(data, {headers: {"content-type": type}});
  };
  return loadPyodide({indexURL: FROM, stdLibURL: `${FROM}library.zip`, lockFileContents: JSON.parse($("lock").textContent), checkAPIVersion: false});
}

function node(kind, text, more = {}) {
  return Object.assign(document.createElement(kind), {textContent: text}, more);
}

function build(groups) {
  for (const [group, acts] of groups) {
    const row = node("div", "", {className: "row"}), section = document.createElement("section");
    for (const act of acts) {
      const button = node("button", act.label, {type: "button", className: act.name.startsWith("hang-") ? "pair" : ""});
      Object.assign(button.dataset, {act: act.name, on: act.label, off: act.off});
      if (act.kind === "switch") button.setAttribute("aria-pressed", "true");
      row.append(button);
    }
    section.append(node("h2", group), row);
    section.setAttribute("aria-label", group);
    $("acts").append(section);
  }
}

// A wide screen has room for the reason beside the buttons, above STOP.
const wide = matchMedia("(min-width: 60rem)");
function place() {
  if (wide.matches) $("head").append($("reason"));
  else $("clock").after($("reason"));
}
wide.addEventListener("change", place);
place();

const seconds = (t) => `${t.toFixed(3)} s`;
const text = (id, what) => { if ($(id).textContent !== what) $(id).textContent = what; };

function draw(now) {
  text("time", seconds(now.time));
  $("head").dataset.role = now.view.role;
  $("word").classList.toggle("long", now.view.word.length > 8);
  text("word", now.view.word);
  text("why", now.cause ? now.cause.text : now.view.enabled ? "motion enabled" : "motion disabled");
  $("said").replaceChildren(...now.why.flatMap(([label, what]) => [node("dt", label), node("dd", what)]));
  text("answer", now.answer);
  text("wheels", `wheels: ${now.wheels.map((speed) => speed.toFixed(2)).join(", ")} rps`);
  $("wire").replaceChildren(...now.wire.toReversed().map(([t, who, what, count, bytes]) => {
    const line = node("li", "", {className: what === "motion" ? "" : "zeros"});
    line.append(node("time", seconds(t)), node("span", ""), node("code", bytes));
    line.children[1].append(`${who.replace("_", " ")}: `, node("b", what), count > 1 ? `, ${count} frames` : "");
    return line;
  }));
  $("told").replaceChildren(...now.events.toReversed().map(([t, level, what]) => {
    const line = node("li", "");
    line.dataset.level = level;
    line.append(node("time", seconds(t)), node("span", what.replaceAll("`", "")));
    return line;
  }));
  for (const button of document.querySelectorAll("[data-act][aria-pressed]")) {
    const on = now.on[button.dataset.act];
    button.setAttribute("aria-pressed", on);
    const label = on ? button.dataset.on : button.dataset.off;
    if (button.textContent !== label) button.textContent = label;
  }
  globalThis.shown = now;
}

// One thing at a time: a stack of Python's that waits is not entered again.
function ask(what) {
  asked = asked.then(what).catch((error) => { console.error(error); text("answer", `${error}`); });
  return asked;
}

async function turn(ms) {
  if (ms) await show.turn.callPromising(ms / 1000);
}

async function look() {
  draw(JSON.parse(await show.json.callPromising()));
}

addEventListener("click", ({target}) => {
  const button = target.closest("button");
  if (!button || !show) return;
  if (button.dataset.speed !== undefined) {
    speed = Number(button.dataset.speed);
    for (const each of document.querySelectorAll("[data-speed]")) each.setAttribute("aria-pressed", each === button);
  } else if (button.id === "step") {
    ask(async () => { await turn(100); await look(); });
  } else {
    ask(async () => { await show.act.callPromising(button.dataset.act); await look(); });
  }
});
addEventListener("keydown", (event) => {
  if ((event.key === " " && event.target === document.body) || event.key === "Escape") { event.preventDefault(); $("stop").click(); }
});

(async () => {
  if (!("Suspending" in WebAssembly)) {
    text("word", "NOT HERE");
    text("why", "This browser cannot suspend WebAssembly (JavaScript Promise Integration). Chrome, Edge and Chromium can from version 137 on.");
    return;
  }
  const began = performance.now();
  const py = await python();
  py.unpackArchive(await unpack("modules"), "zip", {extractDir: "/failstop"});
  await py.runPythonAsync("import sys; sys.path.insert(0, '/failstop')\nfrom start import acts, show");
  build(JSON.parse(py.globals.get("acts")));
  show = py.globals.get("show");
  await ask(async () => { await turn(300); await look(); });
  globalThis.started_ms = Math.round(performance.now() - began);
  let before = performance.now(), looked = 0;
  for (;;) {
    await new Promise(requestAnimationFrame);
    const now = performance.now();
    const passed = Math.min(now - before, LATEST_MS) * speed;
    before = now;
    if (passed) {
      await ask(() => turn(passed));
      if (now - looked > LOOK_MS) { looked = now; await ask(look); }
    }
  }
})().catch((error) => { console.error(error); text("word", "FAILED"); text("why", `${error}`); });
