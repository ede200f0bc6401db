// The rule for when a measured feature agrees with the library. Drawing and counting share it.

const DEVIATIONS = 2; // standard deviations to each side of a measured change
const MIN_DB = 1; // the scatter of a short baseline underestimates the model's error

/** The rule as shown to the user. */
export const AGREEMENT_RULE = `A feature agrees when its whisker (${DEVIATIONS} baseline standard deviations, at least ${MIN_DB} dB, to each side) reaches its bar`;

/** Half the length of a feature's whisker in dB. */
export function whisker({ scatter_db: scatter }) {
  return Math.max(DEVIATIONS * scatter, MIN_DB);
}

/** Distance of the measurement from the feature's bar, in whisker lengths; at most 1 means agreement. */
function distance(row) {
  const [low, high] = row.expected_interval_db;
  return Math.max(low - row.measured_db, row.measured_db - high, 0) / whisker(row);
}

/** Whether a feature is used: it was above the noise when healthy and the library predicts it. */
export function counts(row) {
  return row.above_noise && row.expected_interval_db != null;
}

/** Whether a used feature agrees with the library. */
export function agrees(row) {
  return distance(row) <= 1;
}

/** The used features, and those of them that disagree, largest distance first. */
export function agreement(features) {
  const used = features.filter(counts);
  return { used, odd: used.filter((row) => !agrees(row)).sort((a, b) => distance(b) - distance(a)) };
}
