// Touch, mouse and wheel as calls: drag, pinch, hover, tap.

export function listenToGestures(element, { drag, pinch, hover, leave, begin, end }) {
  const held = new Map();
  let both = null;

  const at = (event) => {
    const box = element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const spread = () => {
    const [a, b] = [...held.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, wide: Math.max(8, Math.hypot(a.x - b.x, a.y - b.y)) };
  };

  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    held.set(event.pointerId, at(event));
    if (held.size === 2) both = spread();
    else begin(at(event), event);
  });
  element.addEventListener("pointermove", (event) => {
    const now = at(event);
    const before = held.get(event.pointerId);
    if (!before) {
      hover(now);
      return;
    }
    held.set(event.pointerId, now);
    if (held.size === 2) {
      const next = spread();
      pinch(next.wide / both.wide, next, next.x - both.x, next.y - both.y);
      both = next;
    } else if (held.size === 1) drag(now, now.x - before.x, now.y - before.y, event);
  });
  const lift = (event) => {
    if (!held.delete(event.pointerId)) return;
    both = null;
    if (!held.size) end(at(event), event);
  };
  element.addEventListener("pointerup", lift);
  element.addEventListener("pointercancel", lift);
  element.addEventListener("pointerleave", (event) => held.has(event.pointerId) || leave());
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1;
      const now = at(event);
      pinch(Math.exp(-Math.max(-60, Math.min(60, event.deltaY * lines)) * (event.ctrlKey ? 0.01 : 0.003)), now, 0, 0);
    },
    { passive: false },
  );
}
