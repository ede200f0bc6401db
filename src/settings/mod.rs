//! What settings of all modules share: their errors, secrets and certificates.

use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};

#[cfg(any(feature = "mqtt", feature = "postgres"))]
use axum::http::Uri;
use thiserror::Error;
use ureq::tls::{Certificate, PemItem, parse_pem};

/// Why a setting cannot be used.
#[derive(Debug, Error)]
pub enum SettingError {
    /// Its value is invalid.
    #[error("{field} is {value}, expected {expected}")]
    Invalid {
        /// Name of the setting.
        field: String,
        /// Value of the setting.
        value: String,
        /// Description of a valid value.
        expected: String,
    },
    /// The file that it names cannot be read.
    #[error("{field}: failed to read {path}: {source}", path = path.display())]
    File {
        /// Name of the setting.
        field: String,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The program was built without a feature that it requires.
    #[error(
        "{field} requires the feature `{feature}`, and this program was built without it: cargo build --release --features {feature}"
    )]
    WithoutFeature {
        /// The option, table or command.
        field: &'static str,
        /// The feature.
        feature: &'static str,
    },
}

impl SettingError {
    pub(crate) fn new(field: impl Into<String>, value: impl Display, expected: impl Into<String>) -> Self {
        let value = Some(value.to_string()).filter(|value| !value.is_empty());
        let value = value.unwrap_or_else(|| "empty".to_owned());
        Self::Invalid { field: field.into(), value, expected: expected.into() }
    }
}

/// Returns the host and the port of a URL; `None` without a host, or where the port is not from 1 to 65535.
#[cfg(any(feature = "mqtt", feature = "postgres"))]
pub(crate) fn host_and_port(url: &Uri) -> Option<(&str, Option<u16>)> {
    let authority = url.authority()?;
    let host = Some(authority.host()).filter(|host| !host.is_empty())?;
    let port = match authority.as_str().rsplit_once('@').map_or(authority.as_str(), |(_, rest)| rest) {
        rest if rest == host => None,
        rest => Some(rest.strip_prefix(host)?.strip_prefix(':')?.parse().ok().filter(|port| *port > 0)?),
    };
    Some((host, port))
}

/// A secret, or the file that contains it, which is read for each use.
#[derive(Clone)]
pub(crate) struct Secret {
    /// Name of the setting, for error messages.
    pub(crate) field: String,
    source: Source,
}

#[derive(Clone)]
enum Source {
    Text(String),
    File(PathBuf),
}

impl Secret {
    /// Returns the secret of the environment, or else that of a file; `None` without either.
    pub(crate) fn new(field: String, from_env: Option<String>, file: Option<PathBuf>) -> Option<Self> {
        let source = from_env.map(Source::Text).or(file.map(Source::File))?;
        Some(Self { field, source })
    }

    /// Returns the secret without a trailing line break.
    pub(crate) fn text(&self) -> Result<String, SettingError> {
        match &self.source {
            Source::Text(text) => Ok(text.clone()),
            Source::File(path) => {
                let text = String::from_utf8(read(&self.field, path)?).map_err(|_| {
                    SettingError::new(&self.field, path.display(), "a file with the secret in UTF-8")
                })?;
                Ok(text.trim_end_matches(['\r', '\n']).to_owned())
            }
        }
    }
}

/// Reads the certificates of a PEM file.
pub(crate) fn certificates(field: &str, path: &Path) -> Result<Vec<Certificate<'static>>, SettingError> {
    let bytes = read(field, path)?;
    let certificates = parse_pem(&bytes).filter_map(|item| match item {
        Ok(PemItem::Certificate(certificate)) => Some(certificate),
        _ => None,
    });
    let certificates: Vec<_> = certificates.collect();
    if certificates.is_empty() {
        return Err(SettingError::new(field, path.display(), "a PEM file with a certificate"));
    }
    Ok(certificates)
}

fn read(field: &str, path: &Path) -> Result<Vec<u8>, SettingError> {
    fs::read(path).map_err(|source| SettingError::File {
        field: field.to_owned(),
        path: path.to_owned(),
        source,
    })
}
