// The fields of an asset's settings: those of the asset form, grouped for an asset in use.

import { SETUP_FIELDS } from "./setup-fields.js";

const BY_PATH = Object.fromEntries(SETUP_FIELDS.map((field) => [field.path, field]));

/** What differs from the asset form, whose hints are left out. */
const OWN = {
  "location.mesh": { hint: "e.g. second stage" },
  "sensor.of": { hint: "that asset's id, or nothing" },
  "sensor.unit": { hint: "e.g. m/s2", about: "Stored records keep their unit." },
  "sensor.channel": { hint: "all combined" },
  "baseline.records": { label: "Baseline records, at least 8" },
  "gear.shaft_ratio.0": { hint: "1" },
  "gear.shaft_ratio.1": { hint: "1" },
  "shaft.speed_hz": { hint: "from the records" },
  "gear.pair.geometry.centre_distance_mm": { hint: "without backlash" },
  "gear.pair.geometry.bore_radius_mm.0": { hint: "a third of the root radius" },
  "gear.pair.geometry.bore_radius_mm.1": { hint: "a third of the root radius" },
};

const fields = (...paths) => paths.map((path) => ({ ...BY_PATH[path], hint: undefined, ...OWN[path] }));

/**
 * Groups of fields, as in `SETUP_GROUPS`; some only for assets with a gear `mesh`, with a gear `pair`, or with
 * nothing but a `shaft`.
 * @type {any[]}
 */
export const GROUPS = [
  {
    title: "Asset",
    fields: fields(
      "name",
      "location.site",
      "location.machine",
      "location.gearbox",
      "location.mesh",
      "sensor.of",
      "sensor.unit",
      "sensor.channel",
      "baseline.records",
    ),
  },
  {
    title: "Limits on wear depth",
    mesh: true,
    fields: fields("limits.warning_um", "limits.danger_um"),
  },
  {
    title: "Shaft and teeth",
    mesh: true,
    fields: fields(
      "gear.teeth.0",
      "gear.teeth.1",
      "gear.shaft_speed_hz",
      "gear.shaft_ratio.0",
      "gear.shaft_ratio.1",
      "gear.speed_tolerance",
      "gear.speed_is_exact",
    ),
  },
  {
    title: "Shaft",
    shaft: true,
    fields: fields("shaft.speed_hz", "shaft.speed_tolerance", "shaft.speed_is_exact"),
  },
  {
    title: "Gear pair, for the wear library",
    pair: true,
    fields: fields(
      "gear.pair.geometry.module_mm",
      "gear.pair.geometry.face_width_mm",
      "gear.pair.geometry.pressure_angle_deg",
      "gear.pair.geometry.centre_distance_mm",
      "gear.pair.geometry.addendum.0",
      "gear.pair.geometry.addendum.1",
      "gear.pair.geometry.dedendum.0",
      "gear.pair.geometry.dedendum.1",
      "gear.pair.geometry.profile_shift.0",
      "gear.pair.geometry.profile_shift.1",
      "gear.pair.geometry.bore_radius_mm.0",
      "gear.pair.geometry.bore_radius_mm.1",
      "gear.pair.operation.torque_nm",
      "gear.pair.wear.measured",
    ),
  },
];
