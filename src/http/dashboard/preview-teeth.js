// The teeth of a previewed pair as paths in gear coordinates: centre at (0, 0), a tooth on the positive x
// axis.

const place = ([x, y]) => `${x.toFixed(3)} ${y.toFixed(3)}`;
const line = (points) => `M${points.map(place).join("L")}`;

function turned([x, y], angle) {
  const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
  return [x * cos - y * sin, x * sin + y * cos];
}

const mirrored = ([x, y]) => [x, -y];

/**
 * The points of one tooth, from the middle of one space to the next, using every `every`-th profile point.
 */
function toothPoints(profile, every) {
  const half = profile.filter((_, n) => n % every === 0 || n === profile.length - 1);
  return [...half.map(mirrored), ...[...half].reverse()];
}

/** The outline of teeth `from` to `to`, closed through the centre unless it is the whole gear. */
export function bodyPath({ teeth, profile_mm: profile }, from, to, every = 1) {
  const points = [];
  const one = toothPoints(profile, every);
  for (let n = from; n <= to; n++) {
    const angle = (2 * Math.PI * n) / teeth;
    for (const point of one) points.push(turned(point, angle));
  }
  if (to - from + 1 < teeth) points.push([0, 0]);
  return `${line(points)}Z`;
}

/**
 * The worn-off areas of some teeth's working flanks; `side` is 1 for the leading flank in the sense of
 * rotation, −1 for the trailing one.
 */
export function lostPath({ teeth }, { x_mm: xs, y_mm: ys, depth_um: depths }, side, from, to) {
  const before = xs.map((x, n) => [x, side * ys[n]]);
  const after = xs.map((x, n) => [x, side * (ys[n] - depths[n] / 1000)]);
  const one = [...before, ...after.reverse()];
  const paths = [];
  for (let n = from; n <= to; n++)
    paths.push(`${line(one.map((point) => turned(point, (2 * Math.PI * n) / teeth)))}Z`);
  return paths.join("");
}

/**
 * Parts of the profile on both sides of some teeth, from `start` to `end`: 0 is the middle of the space, 1
 * the tip.
 */
export function partPath({ teeth, profile_mm: profile }, start, end, from, to) {
  const last = profile.length - 1;
  const part = profile.slice(Math.round(start * last), Math.round(end * last) + 1);
  const sides = end === 1 ? [[...part, ...[...part].reverse().map(mirrored)]] : [part, part.map(mirrored)];
  const paths = [];
  for (let n = from; n <= to; n++)
    for (const side of sides) paths.push(line(side.map((point) => turned(point, (2 * Math.PI * n) / teeth))));
  return paths.join("");
}
