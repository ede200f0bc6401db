//! Gear pair files given on the command line.

use std::fs;
use std::path::Path;

use crate::cli::CliError;
use crate::gear::PairSpec;

/// The pair of the paper's Table 1, built in so that every command works without a file.
const SHEN2022: &str = include_str!("../../../fixtures/pairs/shen2022.toml");

/// Reads the pair in a file, or the paper's pair where no file is given.
pub(in crate::cli) fn read(path: Option<&Path>) -> Result<PairSpec, CliError> {
    let Some(path) = path else {
        return Ok(PairSpec::from_toml(SHEN2022)?);
    };
    let text = fs::read_to_string(path).map_err(CliError::file(path))?;
    PairSpec::from_toml(&text).map_err(CliError::file(path))
}
