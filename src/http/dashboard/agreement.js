// When a feature agrees with the library: one rule for what is drawn and what is counted.

const DEVIATIONS = 2; // standard deviations to each side of a measured change
const LEAST_DB = 1; // a few records of a baseline may lie closer together by chance than a model is good

/** The rule in words. */
export const AGREEMENT_RULE = `A feature agrees where its whisker, ${DEVIATIONS} standard deviations of the baseline but at least ${LEAST_DB} dB to each side, reaches its bar`;

/** How far a feature's whisker reaches to each side of the measured change, in dB. */
export function whisker({ scatter_db: scatter }) {
  return Math.max(DEVIATIONS * scatter, LEAST_DB);
}

/** How far outside its bar a feature was measured, in lengths of its whisker: up to 1 it agrees. */
function distance(row) {
  const [low, high] = row.expected_interval_db;
  return Math.max(low - row.measured_db, row.measured_db - high, 0) / whisker(row);
}

/** Whether a feature counts: it stood above the noise when healthy, and the library says something of it. */
export function counts(row) {
  return row.above_noise && row.expected_interval_db != null;
}

/** Whether a feature that counts agrees with the library. */
export function agrees(row) {
  return distance(row) <= 1;
}

/** The features that count, and those of them that do not agree, the farthest first. */
export function agreement(features) {
  const used = features.filter(counts);
  return { used, odd: used.filter((row) => !agrees(row)).sort((a, b) => distance(b) - distance(a)) };
}
