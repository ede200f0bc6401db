//! `flankwatch library`: builds, lists and shows libraries of simulated wear states.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};

use super::pair_file;
use crate::cli::interrupt::interrupted;
use crate::cli::output_check::{OutputKind, check_apart, check_result};
use crate::cli::{CliError, output};
use crate::gear::{ContactRule, PairSpec};
use crate::library::{
    self, BuildControl, GridSettings, Library, LibraryCache, LibraryError, build_into, decode,
};

/// Arguments of `flankwatch library`.
#[derive(Args)]
pub(in crate::cli) struct LibraryArgs {
    #[command(subcommand)]
    command: LibraryCommand,
}

#[derive(Subcommand)]
enum LibraryCommand {
    /// Simulate the wear states of a gear pair, or load them from the cache
    ///
    /// After Ctrl-C the same command resumes the build.
    Build(BuildArgs),
    /// List the cached libraries
    List(LibraryCacheArgs),
    /// Show the wear states of a library
    Show(ShowArgs),
}

#[derive(Args)]
struct LibraryCacheArgs {
    /// Data folder; libraries are cached in its folder `libraries`
    #[arg(long, value_name = "DIR", default_value = "flankwatch-data")]
    data_dir: PathBuf,
}

#[derive(Args)]
struct BuildArgs {
    /// Gear pair file (TOML) [default: the pair of Shen et al. 2022]
    #[arg(long, value_name = "FILE")]
    pair: Option<PathBuf>,
    /// Number of wear states
    #[arg(long, default_value_t = 50)]
    states: usize,
    /// Maximum wear depth of the last state in µm [default: 245 at module 6 mm, proportional to the module]
    #[arg(long, value_name = "UM")]
    max_wear_um: Option<f64>,
    /// Length of each simulated record in seconds
    #[arg(long, value_name = "S", default_value_t = 2.0)]
    seconds: f64,
    /// Sampling rate of each simulated record in Hz
    #[arg(long, value_name = "HZ", default_value_t = 20_000.0)]
    rate: f64,
    /// Torques to simulate, as multiples of the pair's torque: ascending, including 1, such as 0.5,1,1.5
    #[arg(long, value_delimiter = ',', default_value = "1")]
    torques: Vec<f64>,
    /// Speeds to simulate, as multiples of the pair's speed: ascending, including 1
    #[arg(long, value_delimiter = ',', default_value = "1")]
    speeds: Vec<f64>,
    /// Rule for which tooth pairs carry load [default: that of the pair file]
    #[arg(long, value_name = "RULE")]
    contact: Option<ContactRule>,
    /// Write the library to this file instead of the data folder; it replaces a library only
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    cache: LibraryCacheArgs,
}

#[derive(Args)]
struct ShowArgs {
    /// Name of a library, as listed, or a library file
    library: String,
    #[command(flatten)]
    cache: LibraryCacheArgs,
}

/// Runs the command.
pub(in crate::cli) fn run(args: &LibraryArgs) -> Result<(), CliError> {
    match &args.command {
        LibraryCommand::Build(args) => build(args),
        LibraryCommand::List(args) => list(args),
        LibraryCommand::Show(args) => show(args),
    }
}

impl LibraryCacheArgs {
    fn cache(&self) -> LibraryCache {
        LibraryCache::new(self.data_dir.join("libraries"))
    }
}

fn build(args: &BuildArgs) -> Result<(), CliError> {
    let mut pair = pair_file::read(args.pair.as_deref())?;
    if let Some(contact) = args.contact {
        pair.dynamics.contact = contact;
    }
    let grid = GridSettings {
        states: args.states,
        max_wear_um: args.max_wear_um.unwrap_or_else(|| pair.usual_wear_um()),
        seconds: args.seconds,
        sample_rate_hz: args.rate,
        torque_factors: args.torques.clone(),
        speed_factors: args.speeds.clone(),
        ..GridSettings::default()
    };
    grid.validate().map_err(|error| match error {
        LibraryError::Grid { field, value, expected } => CliError::option(field, value, expected),
        error => error.into(),
    })?;
    if let Some(out) = &args.out {
        check_apart("--out", out, args.pair.as_deref(), "the gear pair file")?;
        check_result(out, OutputKind::Library)?;
    }
    let bar = progress_bar(grid.simulations() as u64, "simulations");
    let progress = |done: usize, _| bar.set_position(done as u64);
    let interrupted = interrupted();
    let control = BuildControl::with_progress(&progress).cancelled_by(&interrupted);
    let id = library::library_id(&pair, &grid);
    let built = match &args.out {
        None => args.cache.cache().get_or_build(&pair, &grid, &control).map(|_| ()),
        Some(path) => match rebuild_reason(path, &id) {
            None => Ok(()),
            Some(reason) => {
                if path.exists() {
                    tracing::warn!(file = %path.display(), reason, "rebuilding the library");
                }
                build_into(path, &pair, &grid, &control).map(|_| ())
            }
        },
    };
    if let Err(LibraryError::Cancelled) = &built {
        bar.abandon_with_message("interrupted; run the same command to resume");
    }
    built.map_err(|error| match error {
        LibraryError::Gear(error) => {
            CliError::wear("--max-wear-um", format!("{} µm", grid.max_wear_um), error)
        }
        error => error.into(),
    })?;
    bar.finish_and_clear();
    let place = args.out.clone().unwrap_or_else(|| args.cache.data_dir.join("libraries"));
    output::print(&format!("library {id} in {}\n", place.display()))
}

/// Returns why the file is not the library with this name; `None` if it is.
fn rebuild_reason(path: &std::path::Path, id: &str) -> Option<String> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) => return Some(error.to_string()),
    };
    match decode(&bytes) {
        Ok(library) if library.id() == id => None,
        Ok(library) => Some(format!("it was built from other inputs ({})", library.id())),
        Err(error) => Some(error.to_string()),
    }
}

fn list(args: &LibraryCacheArgs) -> Result<(), CliError> {
    let mut text = format!(
        "{:<18} {:<28} {:>6} {:>10} {:>10} {:>7} {:>6}\n",
        "library", "pair", "states", "to_um", "contact", "torques", "speeds"
    );
    if !args.data_dir.is_dir() {
        return Err(CliError::no_data_folder(&args.data_dir));
    }
    for manifest in args.cache().list()? {
        let contact = manifest.contact();
        text += &format!(
            "{:<18} {:<28} {:>6} {:>10} {:>10} {:>7} {:>6}\n",
            manifest.id,
            pair_name(&manifest.pair),
            manifest.grid.states,
            manifest.grid.max_wear_um,
            contact.to_string(),
            manifest.grid.torque_factors.len(),
            manifest.grid.speed_factors.len()
        );
    }
    output::print(&text)
}

/// The pair's name, which a pair need not have.
fn pair_name(pair: &PairSpec) -> &str {
    if pair.name.is_empty() { "without a name" } else { &pair.name }
}

fn show(args: &ShowArgs) -> Result<(), CliError> {
    let path = std::path::Path::new(&args.library);
    if path.is_file() {
        let bytes = std::fs::read(path).map_err(CliError::file(path))?;
        return output::print(&table(&decode(&bytes).map_err(CliError::file(path))?));
    }
    match args.cache.cache().get(&args.library)? {
        Some(library) => output::print(&table(&library)),
        None => Err(CliError::Argument(format!(
            "no library {:?} in {}, see `flankwatch library list`",
            args.library,
            args.cache.data_dir.display()
        ))),
    }
}

fn table(library: &Library) -> String {
    let manifest = library.manifest();
    let mut text = format!(
        "library {} of pair {:?}, contact rule {}, model {}\n",
        library.id(),
        pair_name(&manifest.pair),
        manifest.contact(),
        manifest.model_version
    );
    let (grid, operation) = (&manifest.grid, &manifest.pair.operation);
    let axis = |factors: &[f64], nominal: f64| {
        let values: Vec<String> =
            factors.iter().map(|factor| format!("{}", (1e6 * factor * nominal).round() / 1e6)).collect();
        values.join(", ")
    };
    text += &format!(
        "grid {} wear states × {} N·m × {} Hz, each {} s at {} Hz; the nominal point:\n",
        grid.states,
        axis(&grid.torque_factors, operation.torque_nm),
        axis(&grid.speed_factors, operation.shaft_speed_hz),
        grid.seconds,
        grid.sample_rate_hz
    );
    text += &format!(
        "{:>5} {:>9} {:>12} {:>10} {:>12} {:>12}\n",
        "state", "wear_um", "rms_m_s2", "kurtosis", "omx_m_s2", "turns"
    );
    for state in library.states() {
        let value = |name| state.indicators.get(name).map_or_else(|| "-".to_owned(), |x| format!("{x:.4}"));
        text += &format!(
            "{:>5} {:>9.1} {:>12} {:>10} {:>12} {:>12}\n",
            state.index,
            state.wear_um,
            value("rms"),
            value("kurtosis"),
            value("omx"),
            state.driving_turns.map_or_else(|| "-".to_owned(), |turns| format!("{turns:.3e}"))
        );
    }
    text
}

/// Creates a progress bar on standard error, drawn only on a terminal.
pub(super) fn progress_bar(length: u64, unit: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(&format!(
        "{{bar:32}} {{pos}}/{{len}} {unit} {{elapsed}}, {{eta}} left {{msg}}"
    ));
    ProgressBar::new(length).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
