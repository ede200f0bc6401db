// The fields of the asset form: path in the description, label, unit, and the default when empty.

import { usualBore } from "./setup-derived.js";
import { choice, each, RARE_OF_BEARINGS, RARE_OF_PAIR, RARE_OF_SENSOR } from "./setup-rare-fields.js";

/** Fields of the gear pair; hidden when there is none. */
const pair = (fields) => fields.map((field) => ({ ...field, ofPair: true }));

/**
 * Groups of fields, each `{ path, label, unit?, kind?, hint?, alike?, needed?, factor?, pairDefault?, derived?,
 * isUnit? }`.
 * `factor` converts the entered unit to the description's; `pairDefault` or `derived(spec)` is sent when only the other gear has
 * a value; `derivedFrom` says what that follows from. Fields in `more` and `rare` are folded away.
 * @type {any[]}
 */
export const SETUP_GROUPS = [
  {
    title: "Machine",
    fields: [
      { path: "name", label: "Name", kind: "text", hint: "Pump north" },
      {
        path: "id",
        label: "Id",
        kind: "id",
        needed: true,
        hint: "pump-north",
        about: "Used in addresses and topics: a–z, 0–9, - and _.",
      },
    ],
    more: {
      title: "Location",
      fields: [
        { path: "location.site", label: "Site", kind: "text" },
        { path: "location.machine", label: "Machine", kind: "text" },
        { path: "location.gearbox", label: "Gearbox", kind: "text" },
        {
          path: "location.mesh",
          label: "Mesh, if the gearbox has several",
          kind: "text",
          hint: "second stage",
        },
      ],
    },
  },
  {
    title: "Gears",
    pairChoice: true,
    fields: [
      {
        path: "gear.teeth.0",
        label: "Teeth, driving",
        kind: "integer",
        needed: true,
        alike: "gear.pair.geometry.teeth.0",
      },
      {
        path: "gear.teeth.1",
        label: "Teeth, driven",
        kind: "integer",
        needed: true,
        alike: "gear.pair.geometry.teeth.1",
      },
      {
        path: "gear.shaft_speed_hz",
        label: "Driving shaft speed",
        unit: "rpm",
        factor: 1 / 60,
        needed: true,
        alike: "gear.pair.operation.shaft_speed_hz",
      },
      {
        path: "shaft.speed_hz",
        label: "Nominal shaft speed",
        unit: "rpm",
        factor: 1 / 60,
        hint: "from the records",
      },
      {
        path: "shaft.speed_tolerance",
        label: "Shaft speed search range ±",
        unit: "%",
        factor: 0.01,
        hint: "5",
      },
      { path: "shaft.speed_is_exact", label: "Speed is fixed (do not search)", kind: "check" },
      ...pair([
        {
          path: "gear.pair.operation.torque_nm",
          label: "Torque on the driving gear",
          unit: "N·m",
          needed: true,
        },
        { path: "gear.pair.geometry.module_mm", label: "Module", unit: "mm", needed: true },
        { path: "gear.pair.geometry.face_width_mm", label: "Face width", unit: "mm", needed: true },
        {
          path: "gear.pair.geometry.bore_radius_mm.0",
          label: "Bore radius, driving",
          unit: "mm",
          derived: (spec) => usualBore(spec, 0),
          derivedFrom: "a third of the root radius",
        },
        {
          path: "gear.pair.geometry.bore_radius_mm.1",
          label: "Bore radius, driven",
          unit: "mm",
          derived: (spec) => usualBore(spec, 1),
          derivedFrom: "a third of the root radius",
        },
        {
          path: "gear.pair.geometry.centre_distance_mm",
          label: "Centre distance",
          unit: "mm",
          hint: "without backlash",
        },
        { path: "gear.pair.geometry.pressure_angle_deg", label: "Pressure angle", unit: "°", hint: "20" },
        ...each("gear.pair.geometry.profile_shift", ["Profile shift, driving", "Profile shift, driven"], {
          unit: "modules",
          hint: "0",
          pairDefault: 0,
        }),
      ]),
    ],
    more: {
      title: "Tooth form, material, bearings, wear",
      fields: pair([
        { path: "gear.pair.name", label: "Name of the pair", kind: "text" },
        ...each("gear.pair.geometry.addendum", ["Addendum, driving", "Addendum, driven"], {
          unit: "modules",
          hint: "1",
          pairDefault: 1,
        }),
        ...each("gear.pair.geometry.dedendum", ["Dedendum, driving", "Dedendum, driven"], {
          unit: "modules",
          hint: "1.25",
          pairDefault: 1.25,
        }),
        {
          path: "gear.pair.material.youngs_modulus_pa",
          label: "Young's modulus",
          unit: "GPa",
          factor: 1e9,
          hint: "205, steel",
        },
        { path: "gear.pair.material.poisson_ratio", label: "Poisson's ratio", hint: "0.3" },
        { path: "gear.pair.material.density_kg_per_m3", label: "Density", unit: "kg/m³", hint: "7850" },
        {
          path: "gear.pair.supports.stiffness_n_per_m",
          label: "Bearing stiffness",
          unit: "N/µm",
          factor: 1e6,
          hint: "scaled with the teeth",
        },
        {
          path: "gear.pair.supports.damping_n_s_per_m",
          label: "Bearing damping",
          unit: "N·s/m",
          hint: "scaled with the gears",
        },
        { path: "gear.pair.dynamics.mesh_damping_ratio", label: "Mesh damping ratio", hint: "0.5" },
        choice(
          "gear.pair.dynamics.contact",
          "Contact rule",
          ["", "Loaded: teeth share the load elastically"],
          ["loaded", "Loaded"],
          ["threshold", "Threshold: the paper's rule"],
        ),
        {
          path: "gear.pair.errors.long_period_um",
          label: "Once-per-turn error",
          unit: "µm",
          hint: "5 per mm of module",
        },
        {
          path: "gear.pair.errors.short_period_um",
          label: "Once-per-tooth error",
          unit: "µm",
          hint: "2.5 per mm of module",
        },
        choice(
          "gear.pair.wear.shape",
          "Wear profile",
          ["", "Parabolic: smallest at the pitch point"],
          ["parabolic", "Parabolic"],
          ["floor", "Uniform depth"],
          ["archard", "Archard's law"],
        ),
        {
          path: "gear.pair.wear.pressure_exponent",
          label: "Pressure exponent (Archard)",
          hint: "1",
        },
        { path: "gear.pair.wear.measured", label: "Wear profile was measured", kind: "check" },
      ]),
    },
    rare: RARE_OF_PAIR,
  },
  {
    title: "Bearing and velocity",
    fields: [
      { path: "bearings.0.name", label: "Bearing", kind: "text", hint: "e.g. drive_end" },
      { path: "bearings.0.rolling_elements", label: "Rolling elements", kind: "integer", hint: "e.g. 9" },
      { path: "bearings.0.roller_diameter_mm", label: "Rolling element diameter", unit: "mm" },
      { path: "bearings.0.pitch_diameter_mm", label: "Pitch diameter", unit: "mm" },
      { path: "bearings.0.contact_angle_deg", label: "Contact angle", unit: "°", hint: "0" },
      choice(
        "velocity_zones.machine_class",
        "Velocity zones (ISO 20816)",
        ["", "none"],
        ["group_1_rigid", "above 300 kW, rigid"],
        ["group_1_flexible", "above 300 kW, flexible"],
        ["group_2_rigid", "15 to 300 kW, rigid"],
        ["group_2_flexible", "15 to 300 kW, flexible"],
        ["class_1", "class I: up to 15 kW"],
        ["class_2", "class II: 15 to 75 kW"],
        ["class_3", "class III: large, rigid"],
        ["class_4", "class IV: large, flexible"],
      ),
    ],
    more: {
      title: "Fault frequencies instead of the geometry",
      fields: [
        { path: "bearings.0.orders.bpfo", label: "Outer race (BPFO)", unit: "orders" },
        { path: "bearings.0.orders.bpfi", label: "Inner race (BPFI)", unit: "orders" },
        { path: "bearings.0.orders.bsf", label: "Rolling element (BSF)", unit: "orders" },
        { path: "bearings.0.orders.ftf", label: "Cage (FTF)", unit: "orders" },
      ],
    },
    rare: RARE_OF_BEARINGS,
  },
  {
    title: "Sensor",
    fields: [
      {
        path: "sensor.unit",
        label: "Default unit of samples",
        kind: "text",
        isUnit: true,
        hint: "e.g. m/s2",
        about: "Needed for files without a unit, such as WAV.",
      },
      { path: "points.0.channel", label: "Channel", kind: "text", hint: "any" },
      { path: "points.0.sensitivity", label: "Sensitivity (for documentation)", hint: "e.g. 10.2" },
      {
        path: "points.0.sensitivity_unit",
        label: "Unit of the sensitivity",
        kind: "text",
        hint: "e.g. mV/(m/s2)",
      },
    ],
    more: {
      title: "Position, serial number, shared sensor, speed search, live streams",
      fields: [
        { path: "points.0.place", label: "Position on the machine", kind: "text" },
        { path: "points.0.axis", label: "Direction", kind: "text" },
        { path: "points.0.serial", label: "Serial number", kind: "text" },
        { path: "points.0.calibration_due", label: "Calibration due", kind: "date" },
        {
          path: "sensor.of",
          label: "Shares the sensor of",
          kind: "text",
          hint: "that asset's id",
        },
        ...each(
          "gear.shaft_ratio",
          ["Ratio to the measured shaft: driving teeth", "Ratio to the measured shaft: driven teeth"],
          { kind: "integer", hint: "1", pairDefault: 1 },
        ),
        {
          path: "gear.speed_tolerance",
          label: "Speed search range ±",
          unit: "%",
          factor: 0.01,
          hint: "5",
        },
        { path: "gear.speed_is_exact", label: "Speed is fixed (do not search)", kind: "check" },
        { path: "stream.record_s", label: "Live streams: record length", unit: "s", hint: "10" },
        {
          path: "stream.interval_s",
          label: "Live streams: record interval",
          unit: "s",
          hint: "60",
          about: "0: only on demand.",
        },
        {
          path: "stream.steady.for_s",
          label: "Live streams: record only when steady for",
          unit: "s",
          hint: "10",
          about: "Uses the speed and torque sent with the stream.",
        },
        {
          path: "stream.steady.speed_fraction",
          label: "Steady: speed within ±",
          unit: "%",
          factor: 0.01,
          hint: "2",
        },
        {
          path: "stream.steady.torque_fraction",
          label: "Steady: torque within ±",
          unit: "%",
          factor: 0.01,
          hint: "5",
        },
        {
          path: "stream.steady.at_most_every_s",
          label: "Steady: record interval per operating bin",
          unit: "s",
          hint: "3600",
        },
        {
          path: "stream.on_alarm.before_s",
          label: "Live streams: keep before an alarm",
          unit: "s",
          hint: "30",
          about: "Leave both empty to keep nothing extra.",
        },
        {
          path: "stream.on_alarm.after_s",
          label: "Live streams: keep after an alarm",
          unit: "s",
          hint: "30",
        },
      ],
    },
    rare: RARE_OF_SENSOR,
  },
  {
    title: "Limits on wear depth",
    fields: [
      { path: "limits.warning_um", label: "Warning", unit: "µm" },
      { path: "limits.danger_um", label: "Danger", unit: "µm" },
    ],
  },
  {
    title: "Baseline",
    fields: [{ path: "baseline.records", label: "Baseline records", kind: "integer", hint: "20" }],
  },
];

/** All fields in their order. */
export const SETUP_FIELDS = SETUP_GROUPS.flatMap(({ fields, more, rare }) => [
  ...fields,
  ...(more?.fields ?? []),
  ...(rare?.fields ?? []),
]);
