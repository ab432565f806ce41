// Chart: shows the last half minute, with the newest value on the right. It has a gap wherever no value was known.
const POINTS = 300;
const EVERY_MS = 400; // drawing more often helps nobody, and a touch of STOP waits while the page draws
export const later = window.requestIdleCallback || ((run) => setTimeout(run, 50));

// Draws at most every EVERY_MS, when the page has nothing else to do, however often drawing is requested.
export function seldom(draw) {
  let waits = false;
  return () => {
    if (waits || document.hidden) return;
    waits = true;
    setTimeout(() => later(() => { waits = false; draw(); }, {timeout: EVERY_MS}), EVERY_MS);
  };
}

export class Chart {
  constructor(canvas, least) {
    this.canvas = canvas;
    this.least = least; // the scale goes at least up to this
    this.values = [];
  }

  add(value) {
    this.values.push(value);
    if (this.values.length > POINTS) this.values.shift();
  }

  draw() {
    const ratio = devicePixelRatio || 1, wide = this.canvas.clientWidth, high = this.canvas.clientHeight;
    if (this.canvas.width !== wide * ratio) { this.canvas.width = wide * ratio; this.canvas.height = high * ratio; }
    const pen = this.canvas.getContext("2d");
    const top = Math.max(this.least, ...this.values.filter((value) => value !== null)) * 1.1;
    const style = getComputedStyle(document.documentElement);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, wide, high);
    pen.strokeStyle = style.getPropertyValue("--line");
    pen.beginPath(); pen.moveTo(0, high - 0.5); pen.lineTo(wide, high - 0.5); pen.stroke();
    pen.strokeStyle = style.getPropertyValue("--chart");
    pen.lineWidth = 2;
    pen.beginPath();
    const from = POINTS - this.values.length;
    let drawn = false;
    this.values.forEach((value, at) => {
      if (value === null || value === undefined) { drawn = false; return; }
      const x = (from + at) / (POINTS - 1) * wide, y = high - 2 - value / top * (high - 4);
      if (drawn) pen.lineTo(x, y); else pen.moveTo(x, y);
      drawn = true;
    });
    pen.stroke();
  }
}
