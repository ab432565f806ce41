// Alive: checks whether the browser's main process answers. If it hangs, this page still runs and answers the robot, but gets
// no touches: it can't see a finger leave the stick or a button, or touch STOP.
const EVERY_MS = 100, MOST_MS = 500;
export const TOO_OLD = navigator.locks ? "" : "This browser is too old: the page can't check whether it hangs.";
let answered = -Infinity; // when the newest question was asked that the browser has answered
let watches = false, turn = 0;

// Locks are shared by all tabs, so only the main process can grant one.
export async function answer() {
  const asked = performance.now();
  await navigator.locks.request(`failstop ${Math.random()}`, () => { answered = asked; });
}

export async function watch(on) {
  if (on === watches) return;
  watches = on;
  for (const own = ++turn; watches && own === turn;) {
    await answer().catch(() => {});
    await new Promise((go) => setTimeout(go, EVERY_MS));
  }
}

export function alive() {
  return performance.now() - answered <= MOST_MS;
}
