// View: keeps STOP visible, at the same size, while fingers enlarge the page or a keyboard covers its lower end.
const bar = document.getElementById("bar"), view = window.visualViewport;

function follow() {
  bar.style.transform = "";
  const foot = bar.getBoundingClientRect().bottom, seen = view.offsetTop + view.height;
  if (view.scale === 1 && Math.abs(seen - foot) < 1) return;
  bar.style.transform = `translate(${view.offsetLeft}px, ${seen - foot}px) scale(${1 / view.scale})`;
}

if (view) for (const change of ["resize", "scroll"]) view.addEventListener(change, follow);
