// Rarely used fields of a description, folded away in their group.

/** Fields of a list's values, such as those of both gears. */
export const each = (path, labels, rest) =>
  labels.map((label, index) => ({ path: `${path}.${index}`, label, ...rest }));

/** Fields that are set together or not at all, such as the ends of a band. */
const both = (path, labels, rest) => each(path, labels, { together: path, ...rest });

export const choice = (path, label, ...choices) => ({ path, label, kind: "choice", choices });

/** Of the gear pair. */
export const RARE_OF_PAIR = {
  title: "Simulation in detail: random error, masses, response, wear law",
  fields: [
    {
      path: "gear.pair.operation.output_torque_nm",
      label: "Torque on the driven gear",
      unit: "N·m",
      hint: "balances the other gear",
    },
    {
      path: "gear.pair.errors.random_um",
      label: "Range of the random error",
      unit: "µm",
      hint: "1/30 per mm of module",
    },
    {
      path: "gear.pair.errors.random_clock_hz",
      label: "Update rate of the random error",
      unit: "Hz",
      hint: "20000",
    },
    { path: "gear.pair.errors.seed", label: "Seed of the random error", kind: "integer", hint: "1" },
    {
      path: "gear.pair.errors.short_period_phase",
      label: "Phase of the once-per-tooth error",
      unit: "mesh periods",
      hint: "0",
    },
    ...both("gear.pair.dynamics.mass_kg", ["Mass, driving gear", "Mass, driven gear"], {
      unit: "kg",
      hint: "of a solid disc",
    }),
    ...both(
      "gear.pair.dynamics.inertia_kg_m2",
      ["Moment of inertia, driving gear", "Moment of inertia, driven gear"],
      { unit: "kg·m²", hint: "of the same discs" },
    ),
    choice(
      "gear.pair.dynamics.plane",
      "Plane deformation of loaded teeth",
      ["", "Plane strain: wide gears"],
      ["strain", "Plane strain"],
      ["stress", "Plane stress: thin gears"],
    ),
    choice(
      "gear.pair.dynamics.response",
      "Simulated sensor position",
      ["", "At the driving gear's bearings"],
      ["bearing1", "Bearings, driving"],
      ["bearing2", "Bearings, driven"],
      ["mesh", "In the mesh"],
    ),
    {
      path: "gear.pair.dynamics.contact_threshold_rad",
      label: "Threshold of the contact rule “threshold”",
      unit: "rad",
      hint: "0.0001",
    },
    { path: "gear.pair.wear.exponent", label: "Exponent of parabolic wear", hint: "4" },
    { path: "gear.pair.wear.floor", label: "Wear at the pitch point, fraction of the maximum", hint: "0.05" },
    { path: "gear.pair.wear.tip_ratio", label: "Wear at the tip, fraction of that at the root", hint: "0.7" },
    { path: "gear.pair.wear.coefficient", label: "Wear coefficient (Archard)", hint: "1.7e-7" },
    ...both("gear.pair.wear.hardness_pa", ["Hardness, driving flanks", "Hardness, driven flanks"], {
      unit: "GPa",
      factor: 1e9,
      hint: "7",
      pairDefault: 7e9,
    }),
  ].map((field) => ({ ...field, ofPair: true })),
};

/** Of bearings and velocity zones. */
export const RARE_OF_BEARINGS = {
  title: "Custom zone limits, bearing on a geared shaft",
  fields: [
    ...both("velocity_zones.limits_mm_per_s", ["Zone A to", "Zone B to", "Zone C to"], { unit: "mm/s" }),
    ...both(
      "bearings.0.shaft_ratio",
      ["Shaft of the bearing: driving teeth", "Shaft of the bearing: driven teeth"],
      {
        kind: "integer",
        hint: "1",
        pairDefault: 1,
      },
    ),
  ],
};

/** Of the sensor and of what is computed from its records. */
export const RARE_OF_SENSOR = {
  title: "Unit and calibration of the channel, envelope, custom band, other meshes",
  fields: [
    {
      path: "sensor.channel",
      label: "Channel used for wear",
      kind: "text",
      hint: "all combined",
    },
    { path: "points.0.unit", label: "Unit of the channel", kind: "text", hint: "as above", isUnit: true },
    { path: "points.0.calibrated_on", label: "Calibrated on", kind: "date" },
    ...both("envelope_band_hz", ["Envelope band from", "Envelope band to"], {
      unit: "Hz",
      hint: "automatic",
    }),
    choice(
      "envelope_band",
      "Band selection",
      ["", "Around the strongest mesh harmonic"],
      ["mesh_harmonic", "Strongest mesh harmonic"],
      ["kurtogram", "Kurtogram"],
    ),
    { path: "gear_indicators", label: "Omit order-tracked gear indicators", kind: "off" },
    {
      path: "bands.0.name",
      label: "Name of a custom band",
      kind: "text",
      hint: "low",
      together: "bands.0.band_hz",
    },
    ...both("bands.0.band_hz", ["Custom band from", "Custom band to"], { unit: "Hz" }),
    choice(
      "bands.0.quantity",
      "Quantity in the band",
      ["", "As recorded (default)"],
      ["record", "As recorded"],
      ["velocity", "Velocity, mm/s"],
    ),
    ...both("gear.other_meshes.0.teeth", ["Other mesh: driving teeth", "Other mesh: driven teeth"], {
      kind: "integer",
    }),
    ...both(
      "gear.other_meshes.0.shaft_ratio",
      ["Ratio of its driving shaft to the measured one: driving teeth", "… driven teeth"],
      { kind: "integer", hint: "1", pairDefault: 1 },
    ),
  ],
};
