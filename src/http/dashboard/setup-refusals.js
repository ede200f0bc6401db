// Errors of a new description that need no question to the service.

/** The fields without which an asset cannot be created; those of the pair can be done without. */
export function requiredWords(lacking) {
  const words = `Still required: ${lacking.map(({ label }) => `“${label}”`).join(", ")}.`;
  return lacking.every(({ ofPair }) => ofPair)
    ? `${words} Without them, choose “None: indicators only” as the gear pair: everything but the wear in µm is computed.`
    : words;
}

/** Errors that the page can detect by itself. */
export function typedRefusals({ id, limits, points, velocity_zones: zones }) {
  const refusals = [];
  if (id && !/^[a-z0-9][a-z0-9_-]{0,63}$/.test(id))
    refusals.push({
      field: "id",
      value: id,
      expected: "1 to 64 characters of a–z, 0–9, - and _, the first a letter or digit",
    });
  if (limits?.warning_um > limits?.danger_um)
    refusals.push({
      field: "limits.warning_um",
      value: limits.warning_um,
      expected: "a depth at or below the danger limit",
    });
  if (zones?.machine_class && zones.limits_mm_per_s)
    refusals.push({
      field: "velocity_zones.limits_mm_per_s",
      expected: "no custom limits together with a machine class",
    });
  for (const [n, point] of (points ?? []).entries())
    if (!point?.channel)
      refusals.push({ field: `points.${n}.channel`, expected: "a name, as its sensor has data" });
  return refusals;
}
