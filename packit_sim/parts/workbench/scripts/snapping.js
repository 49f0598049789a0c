// Where a part that is moved by hand snaps to: walls, the floor, neighbours, and whole millimetres.

const MILLIMETRES = { mm: 1, cm: 0.1, m: 0.001, in: 1 / 25.4 };
const NEAR = 0.02; // of the longest side of the box

const millimetre = (unit) => MILLIMETRES[unit];

// The places of a part's lower end along an axis at which it touches something, given its corners.
function stops(found, box, part, [low, high], axis) {
  const side = high[axis] - low[axis];
  const walls = [found.walls[0][axis], box.sides[axis] - found.walls[1][axis] - side];
  const others = box.parts.flatMap((_, n) => {
    if (n === part) return [];
    const isBeside = [0, 1, 2].every((k) => k === axis || (low[k] < box.high[n][k] + found.gap && box.low[n][k] < high[k] + found.gap));
    return isBeside ? [box.low[n][axis] - found.gap - side, box.high[n][axis] + found.gap] : [];
  });
  return [...walls, ...others];
}

const nearest = (places, at) => places.reduce((best, each) => (Math.abs(each - at) < Math.abs(best - at) ? each : best), Infinity);

// Return how far a part is shifted along the axes that it is dragged along, so that it snaps.
export function snapped(found, box, part, corners, axes) {
  const shift = [0, 0, 0];
  const reach = NEAR * Math.max(...box.sides);
  for (const axis of axes) {
    const at = corners[0][axis];
    const stop = nearest(stops(found, box, part, corners, axis), at);
    const step = millimetre(found.unit);
    shift[axis] = (Math.abs(stop - at) <= reach ? stop : Math.round(at / step) * step) - at;
  }
  return shift;
}

// Return the shift of a step along an axis, which ends at the first stop and on the grid.
export function stepped(found, box, part, corners, axis, steps) {
  const step = millimetre(found.unit);
  const at = corners[0][axis];
  const sign = Math.sign(steps);
  const grid = (sign > 0 ? Math.floor(at / step + 1e-6) : Math.ceil(at / step - 1e-6)) * step + steps * step;
  const between = stops(found, box, part, corners, axis).filter((each) => sign * (each - at) > 1e-6 * step && sign * (grid - each) > 0);
  return nearest([grid, ...between], at) - at;
}
