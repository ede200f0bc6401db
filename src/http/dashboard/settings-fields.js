// The fields of an asset's settings: path in the description, label, and unit.

import { depth } from "./format.js";

/**
 * Groups of fields, `{ path, label, unit?, kind?, hint?, factor?, isUnit?, about? }` each; numbers in a path are
 * list indices, `factor` converts the entered unit to the description's.
 * @type {any[]}
 */
export const GROUPS = [
  {
    title: "Asset",
    fields: [
      { path: "name", label: "Name", kind: "text" },
      { path: "location.site", label: "Site", kind: "text" },
      { path: "location.machine", label: "Machine", kind: "text" },
      { path: "location.gearbox", label: "Gearbox", kind: "text" },
      {
        path: "location.mesh",
        label: "Mesh, if the gearbox has several",
        kind: "text",
        hint: "e.g. second stage",
      },
      {
        path: "sensor.of",
        label: "Uses the sensor of asset",
        kind: "text",
        hint: "that asset's id, or nothing",
      },
      {
        path: "sensor.unit",
        label: "Default unit of samples",
        kind: "text",
        hint: "e.g. m/s2",
        isUnit: true,
        about: "Stored records keep their unit.",
      },
      {
        path: "sensor.channel",
        label: "Channel used for wear",
        kind: "text",
        hint: "all combined",
      },
      { path: "baseline.records", label: "Baseline records, at least 8", kind: "integer" },
    ],
  },
  {
    title: "Limits on wear depth",
    mesh: true,
    fields: [
      { path: "limits.warning_um", label: "Warning", unit: "µm" },
      { path: "limits.danger_um", label: "Danger", unit: "µm" },
    ],
  },
  {
    title: "Shaft and teeth",
    mesh: true,
    fields: [
      { path: "gear.teeth.0", label: "Teeth, driving", kind: "integer", alike: "gear.pair.geometry.teeth.0" },
      { path: "gear.teeth.1", label: "Teeth, driven", kind: "integer", alike: "gear.pair.geometry.teeth.1" },
      {
        path: "gear.shaft_speed_hz",
        label: "Driving shaft speed",
        unit: "rpm",
        factor: 1 / 60,
        alike: "gear.pair.operation.shaft_speed_hz",
      },
      {
        path: "gear.shaft_ratio.0",
        label: "Ratio to the measured shaft: driving teeth",
        kind: "integer",
        hint: "1",
      },
      {
        path: "gear.shaft_ratio.1",
        label: "Ratio to the measured shaft: driven teeth",
        kind: "integer",
        hint: "1",
      },
      { path: "gear.speed_tolerance", label: "Speed search range ±", unit: "%", factor: 0.01 },
      { path: "gear.speed_is_exact", label: "Nominal speed is exact", kind: "check" },
    ],
  },
  {
    title: "Shaft",
    shaft: true,
    fields: [
      {
        path: "shaft.speed_hz",
        label: "Nominal shaft speed",
        unit: "rpm",
        factor: 1 / 60,
        hint: "from the records",
      },
      { path: "shaft.speed_tolerance", label: "Shaft speed search range ±", unit: "%", factor: 0.01 },
      { path: "shaft.speed_is_exact", label: "Nominal shaft speed is exact", kind: "check" },
    ],
  },
  {
    title: "Gear pair, for the wear library",
    pair: true,
    fields: [
      { path: "gear.pair.geometry.module_mm", label: "Module", unit: "mm" },
      { path: "gear.pair.geometry.face_width_mm", label: "Face width", unit: "mm" },
      { path: "gear.pair.geometry.pressure_angle_deg", label: "Pressure angle", unit: "°" },
      {
        path: "gear.pair.geometry.centre_distance_mm",
        label: "Centre distance",
        unit: "mm",
        hint: "without backlash",
      },
      { path: "gear.pair.geometry.addendum.0", label: "Addendum, driving", unit: "modules" },
      { path: "gear.pair.geometry.addendum.1", label: "Addendum, driven", unit: "modules" },
      { path: "gear.pair.geometry.dedendum.0", label: "Dedendum, driving", unit: "modules" },
      { path: "gear.pair.geometry.dedendum.1", label: "Dedendum, driven", unit: "modules" },
      { path: "gear.pair.geometry.profile_shift.0", label: "Profile shift, driving", unit: "modules" },
      { path: "gear.pair.geometry.profile_shift.1", label: "Profile shift, driven", unit: "modules" },
      {
        path: "gear.pair.geometry.bore_radius_mm.0",
        label: "Bore radius, driving",
        unit: "mm",
        hint: "a third of the root radius",
      },
      {
        path: "gear.pair.geometry.bore_radius_mm.1",
        label: "Bore radius, driven",
        unit: "mm",
        hint: "a third of the root radius",
      },
      { path: "gear.pair.operation.torque_nm", label: "Torque on the driving gear", unit: "N·m" },
      { path: "gear.pair.wear.measured", label: "Wear profile was measured", kind: "check" },
    ],
  },
];

/** How deep wear can be estimated; empty when unknown. */
export const reachWords = (most) =>
  most ? `Wear can be estimated up to ${depth(most)} µm for this pair.` : "";

/** A warning about a limit above the greatest wear that can be estimated; empty for others. */
export const beyondWords = (limit, most) =>
  most && limit > most ? `No estimate reaches this limit: wear is estimated up to ${depth(most)} µm.` : "";

/** Removes the rounding noise of a unit factor from a number. */
export const tidy = (value) => Number(value.toPrecision(12));

/** The value at a path of an object; undefined when missing. */
export function valueAt(object, path) {
  return path.split(".").reduce((inner, key) => inner?.[key], object);
}

/**
 * Sets a value at a path and creates missing parents; undefined deletes the value, and a list that becomes
 * empty.
 */
export function putAt(object, path, value) {
  const keys = path.split(".");
  const last = keys.pop();
  const inner = keys.reduce(
    (at, key, place) => (at[key] ??= Number.isInteger(Number(keys[place + 1] ?? last)) ? [] : {}),
    object,
  );
  if (value === undefined) delete inner[last];
  else inner[last] = value;
  if (Array.isArray(inner) && inner.every((each) => each === undefined))
    putAt(object, keys.join("."), undefined);
}
