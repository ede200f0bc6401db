// The fields of an asset's settings: where each stands in its description, what it is called, and its unit.

/**
 * Groups of fields, `{ path, label, unit?, kind?, hint? }` each; a path's numbers are places in a list.
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
        label: "Mesh, where the gearbox has several",
        kind: "text",
        hint: "for example second stage",
      },
      {
        path: "sensor.of",
        label: "Heard by the sensor of another asset",
        kind: "text",
        hint: "that asset's id, or nothing",
      },
      {
        path: "sensor.unit",
        label: "Unit of samples that come without one",
        kind: "text",
        hint: "for example m/s2",
      },
      {
        path: "sensor.channel",
        label: "Channel that speaks for the asset",
        kind: "text",
        hint: "the first one seen",
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
        label: "Nominal speed of the driving shaft",
        unit: "Hz",
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
      { path: "gear.speed_tolerance", label: "Speed is searched within ±", unit: "of nominal" },
      { path: "gear.speed_is_exact", label: "The nominal speed is exact", kind: "check" },
    ],
  },
  {
    title: "Shaft",
    shaft: true,
    fields: [
      { path: "shaft.speed_hz", label: "Nominal speed", unit: "Hz", hint: "comes with the records" },
      { path: "shaft.speed_tolerance", label: "Speed is searched within ±", unit: "of nominal" },
      { path: "shaft.speed_is_exact", label: "The nominal speed is exact", kind: "check" },
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
      { path: "gear.pair.geometry.bore_radius_mm.0", label: "Bore radius, driving", unit: "mm" },
      { path: "gear.pair.geometry.bore_radius_mm.1", label: "Bore radius, driven", unit: "mm" },
      { path: "gear.pair.operation.torque_nm", label: "Torque on the driving gear", unit: "N·m" },
      { path: "gear.pair.wear.measured", label: "The shape of the wear was measured", kind: "check" },
    ],
  },
];

/** The value at a path of an object, undefined where there is none. */
export function valueAt(object, path) {
  return path.split(".").reduce((inner, key) => inner?.[key], object);
}

/** Puts a value at a path, making what is missing on the way; undefined takes it out, and a list with it of which nothing is left. */
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
