// What a mouse, a finger or two do on the display: point, press, drag, turn the wheel, pinch.

const LEAST_DRAG = 4; // pixels

/** Hear them in a box: pan(dx, dy), zoom(factor, x, y), point(x, y) or point(null), press(x, y). */
export function hearGestures(box, { pan, zoom, point, press }) {
  const down = new Map(); // pointers that touch, and where each is
  let start = null, moved = false;

  const at = ({ clientX, clientY }) => {
    const { left, top } = box.getBoundingClientRect();
    return { x: clientX - left, y: clientY - top };
  };
  const end = ({ pointerId }) => {
    down.delete(pointerId);
    if (!down.size) box.classList.remove("dragged");
    start = null; // whoever lifts one finger of two does not drag by the other at once
  };

  box.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
  }, { passive: false });
  box.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    down.set(event.pointerId, at(event));
    box.setPointerCapture(event.pointerId);
    if (down.size === 1) [start, moved] = [at(event), false];
  });
  box.addEventListener("pointermove", (event) => {
    const now = at(event), before = down.get(event.pointerId);
    if (!before) {
      point(now.x, now.y);
      return;
    }
    if (down.size === 1) {
      point(now.x, now.y);
      if (!start || (!moved && Math.hypot(now.x - start.x, now.y - start.y) < LEAST_DRAG)) return;
      moved = true;
      box.classList.add("dragged");
      pan(now.x - before.x, now.y - before.y);
    } else if (down.size === 2) {
      moved = true;
      const [other] = [...down].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const apart = (place) => Math.hypot(place.x - other.x, place.y - other.y);
      pan((now.x - before.x) / 2, (now.y - before.y) / 2);
      zoom(Math.max(apart(now), 1) / Math.max(apart(before), 1), (now.x + other.x) / 2, (now.y + other.y) / 2);
    }
    down.set(event.pointerId, now);
  });
  box.addEventListener("pointerup", (event) => {
    const { x, y } = at(event), pressed = down.size === 1 && start && !moved;
    end(event);
    if (pressed) press(x, y);
  });
  box.addEventListener("pointercancel", end);
  box.addEventListener("pointerleave", () => { if (!down.size) point(null); });
}
