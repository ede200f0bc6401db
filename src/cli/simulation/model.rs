//! `flankwatch model`: mesh stiffness and transmission error over one mesh period of a gear pair.

use std::fs;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::pair_file;
use crate::cli::CliError;
use crate::gear::{ArchardWear, ContactRule, FlankWear, MeshCycle};

/// Arguments of `flankwatch model`.
#[derive(Debug, Args)]
pub(in crate::cli) struct ModelArgs {
    /// Gear pair file (TOML) [default: the pair of Shen et al. 2022]
    #[arg(long, value_name = "FILE")]
    pair: Option<PathBuf>,
    /// Maximum wear depth in mm, distributed in the pair's wear shape
    #[arg(long, value_name = "MM", conflicts_with = "profile")]
    wear_mm: Option<f64>,
    /// Wear after this many turns of the driving gear, by Archard's law
    ///
    /// Uses the pair's wear coefficient and hardness.
    #[arg(long, conflicts_with_all = ["profile", "wear_mm"])]
    turns: Option<f64>,
    /// Wear table: CSV file with the columns gear,radius_mm,depth_um
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// Rule for which tooth pairs carry load [default: that of the pair file]
    #[arg(long, value_name = "RULE")]
    contact: Option<ContactRule>,
    /// Torque on the driving gear in N·m [default: that of the pair file]
    #[arg(long, value_name = "NM")]
    torque_nm: Option<f64>,
    /// Number of points in the mesh period
    #[arg(long, default_value_t = 1000)]
    points: usize,
    /// Output format
    #[arg(long, default_value = "csv")]
    format: Format,
}

/// Output formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum Format {
    /// A header and one line per point
    Csv,
    /// One JSON array with an object per point
    Json,
}

/// One point of the mesh period.
#[derive(Debug, Serialize)]
struct Row {
    phi1_rad: f64,
    phi2_rad: f64,
    stiffness_n_per_m: f64,
    uste_rad: f64,
    pairs_in_contact: u32,
}

/// Prints one mesh period: `points` evenly spaced angles starting at the nominal start of contact, without
/// the period's end. A closed pipe is not an error.
pub(in crate::cli) fn run(args: &ModelArgs) -> Result<(), CliError> {
    let cycle = cycle(args)?;
    match write(&cycle, args.format, BufWriter::new(io::stdout().lock())) {
        Err(source) if source.kind() != ErrorKind::BrokenPipe => {
            Err(CliError::file("standard output")(source))
        }
        _ => Ok(()),
    }
}

fn cycle(args: &ModelArgs) -> Result<MeshCycle, CliError> {
    let mut spec = pair_file::read(args.pair.as_deref())?;
    if let Some(contact) = args.contact {
        spec.dynamics.contact = contact;
    }
    if let Some(torque_nm) = args.torque_nm {
        spec.operation.torque_nm = torque_nm;
    }
    let pair = spec.resolve()?;
    let wear = match (&args.profile, args.wear_mm, args.turns) {
        (Some(path), ..) => {
            let table = fs::read_to_string(path).map_err(CliError::file(path))?;
            FlankWear::from_table_csv(&pair, &table).map_err(CliError::file(path))?
        }
        (None, Some(depth_mm), _) => FlankWear::from_shape(&pair, depth_mm)
            .map_err(|error| CliError::wear("--wear-mm", format!("{depth_mm} mm"), error))?,
        (None, None, Some(turns)) => {
            let failed = |error| CliError::wear("--turns", turns, error);
            ArchardWear::after_turns(&pair, turns).map_err(failed)?.wear
        }
        (None, None, None) => FlankWear::none(),
    };
    Ok(MeshCycle::compute(&pair, &wear, args.points)?)
}

fn rows(cycle: &MeshCycle) -> impl Iterator<Item = Row> {
    (0..cycle.phi1_rad.len()).map(|i| Row {
        phi1_rad: cycle.phi1_rad[i],
        phi2_rad: cycle.phi2_rad[i],
        stiffness_n_per_m: cycle.stiffness_n_per_m[i],
        uste_rad: cycle.uste_rad[i],
        pairs_in_contact: cycle.pairs_in_contact[i],
    })
}

fn write(cycle: &MeshCycle, format: Format, mut out: impl Write) -> io::Result<()> {
    match format {
        Format::Csv => {
            let mut csv = csv::Writer::from_writer(&mut out);
            for row in rows(cycle) {
                csv.serialize(row).map_err(into_io_error)?;
            }
            csv.flush()?;
        }
        Format::Json => {
            serde_json::to_writer_pretty(&mut out, &rows(cycle).collect::<Vec<_>>())?;
            writeln!(out)?;
        }
    }
    out.flush()
}

/// Unwraps the system's error, so that a closed pipe is recognised.
fn into_io_error(error: csv::Error) -> io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::{Format, ModelArgs, cycle, write};

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        model: ModelArgs,
    }

    fn printed(arguments: &[&str], format: Format) -> Result<String, String> {
        let line = Line::try_parse_from(std::iter::once(&"model").chain(arguments))
            .map_err(|error| error.to_string())?;
        let cycle = cycle(&line.model).map_err(|error| error.to_string())?;
        let mut out = Vec::new();
        write(&cycle, format, &mut out).map_err(|error| error.to_string())?;
        String::from_utf8(out).map_err(|error| error.to_string())
    }

    #[test]
    fn csv_has_the_documented_columns_and_starts_at_the_nominal_start_of_contact() {
        let text = printed(&[], Format::Csv).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("phi1_rad,phi2_rad,stiffness_n_per_m,uste_rad,pairs_in_contact"));
        let first: Vec<f64> = lines.next().unwrap().split(',').map(|field| field.parse().unwrap()).collect();
        assert!((first[0] + 0.277_624_056).abs() < 1e-9);
        assert_eq!(first[4], 2.0);
        assert_eq!(lines.count(), 999);
    }

    #[test]
    fn json_has_the_same_numbers() {
        let arguments =
            ["--wear-mm", "0.1", "--points", "50", "--torque-nm", "500", "--contact", "threshold"];
        let rows: Vec<serde_json::Value> =
            serde_json::from_str(&printed(&arguments, Format::Json).unwrap()).unwrap();
        let csv = printed(&arguments, Format::Csv).unwrap();
        assert_eq!(rows.len(), 50);
        for (row, line) in rows.iter().zip(csv.lines().skip(1)) {
            let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
            assert_eq!(row["phi2_rad"].as_f64(), Some(fields[1]));
            assert_eq!(row["stiffness_n_per_m"].as_f64(), Some(fields[2]));
            assert_eq!(row["pairs_in_contact"].as_f64(), Some(fields[4]));
        }
    }

    /// First row of `fixtures/reference/mesh-stiffness-fe/K_perfect.csv` and of its 130 N·m table.
    #[test]
    fn loaded_contact_depends_on_the_torque() {
        for (torque, reference) in [("1300", 6.973_874e8), ("130", 6.630_292e8)] {
            let arguments = ["--contact", "loaded", "--torque-nm", torque, "--points", "64"];
            let text = printed(&arguments, Format::Csv).unwrap();
            let stiffness: f64 =
                text.lines().nth(1).and_then(|line| line.split(',').nth(2)).unwrap().parse().unwrap();
            assert!((stiffness / reference - 1.0).abs() < 0.02, "{torque} {stiffness}");
        }
    }

    /// In single contact, x from the pitch point along the line of action, flanks of curvature radii L₁, L₂
    /// slide by (1 + z₁/z₂) |x| a radian while the contact moves over them by L₁ and L₂ z₁/z₂: a turn takes k
    /// F/b (1 + z₁/z₂) |x| (1/L₁ + 1/L₂) off both, by which the driven gear lags.
    #[test]
    fn turns_wear_as_archards_law_says() {
        let turns = 40_000.0;
        let arguments = |turns: &str| {
            [
                "--turns".to_owned(),
                turns.to_owned(),
                "--contact".into(),
                "threshold".into(),
                "--points".into(),
                "200".into(),
            ]
        };
        let rows = |turns: &str| -> Vec<Vec<f64>> {
            let arguments = arguments(turns);
            let text = printed(&arguments.each_ref().map(String::as_str), Format::Csv).unwrap();
            text.lines()
                .skip(1)
                .map(|line| line.split(',').map(|field| field.parse().unwrap()).collect())
                .collect()
        };
        let row = rows("40000")
            .into_iter()
            .min_by(|a, b| (a[0] + 0.03).abs().total_cmp(&(b[0] + 0.03).abs()))
            .unwrap();
        // Unworn radii of curvature and the distance from the pitch point along the line of action, in mm.
        let (angle, bases) =
            (20.0_f64.to_radians(), [24.0, 26.0].map(|z: f64| 3.0 * z * 20.0_f64.to_radians().cos()));
        let half_angle = std::f64::consts::PI / 48.0 + angle.tan() - angle;
        let first = bases[0] * (row[0] + angle + half_angle);
        let lengths = [first, (bases[0] + bases[1]) * angle.tan() - first];
        let from_pitch = first - bases[0] * angle.tan();
        let force_n_per_mm = 1300e3 / (50.0 * bases[0]);
        // The default K and H.
        let k_mm2_per_n = 1.7e-7 / 7e9 * 1e6;
        let slid = (1.0 + 24.0 / 26.0) * from_pitch.abs();
        let lost = turns * k_mm2_per_n * force_n_per_mm * slid * (1.0 / lengths[0] + 1.0 / lengths[1]);
        let lag_mm = row[3] * bases[1];
        assert!((lag_mm / lost - 1.0).abs() < 0.05, "{lag_mm} {lost}");
        assert!(rows("0").iter().all(|row| row[3].abs() < 1e-12));
        assert!(printed(&["--turns=-1"], Format::Csv).unwrap_err().contains("--turns is -1"));
        let deep = printed(&["--turns", "1e12"], Format::Csv).unwrap_err();
        assert!(deep.starts_with("--turns is 1000000000000, expected a smaller depth"), "{deep}");
        assert!(printed(&["--turns", "5", "--wear-mm", "0.1"], Format::Csv).is_err());
    }

    #[test]
    fn refusals_name_the_field_or_the_file() {
        assert!(
            printed(&["--torque-nm", "0"], Format::Csv).unwrap_err().contains("operation.torque_nm is 0")
        );
        assert!(printed(&["--wear-mm", "NaN"], Format::Csv).unwrap_err().contains("--wear-mm is NaN mm"));
        assert!(printed(&["--points", "1"], Format::Csv).unwrap_err().contains("points is 1"));
        assert!(printed(&["--pair", "no/such.toml"], Format::Csv).unwrap_err().contains("no/such.toml"));
        assert!(printed(&["--wear-mm", "0.1", "--profile", "x.csv"], Format::Csv).is_err());
        assert!(printed(&["--contact", "elastic"], Format::Csv).unwrap_err().contains("threshold"));
    }
}
