//! The server that a command sends requests to.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use jiff::Timestamp;
use tokio_rustls::rustls::{self, CertificateError};
use ureq::tls::{RootCerts, TlsConfig};

use crate::asset::AssetId;
use crate::cli::CliError;
use crate::settings::certificates;

/// Timeout of a request that may change or list many records.
pub(super) const TIMEOUT: Duration = Duration::from_secs(600);

/// Address and credentials of a server.
#[derive(Debug, Clone, Args)]
pub(super) struct ServerArgs {
    /// URL of the server
    #[arg(long, default_value = "http://127.0.0.1:8600", value_parser = server_url)]
    url: String,
    /// CA certificates (PEM) to verify the server with [default: the public CAs]
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// API token [default: the environment variable FLANKWATCH_TOKEN]
    #[arg(long)]
    token: Option<String>,
}

impl ServerArgs {
    /// Returns a client whose requests end after `timeout`.
    pub(super) fn agent(&self, timeout: Duration) -> Result<ureq::Agent, CliError> {
        let authorities = match &self.ca {
            None => RootCerts::WebPki,
            Some(file) => RootCerts::from(certificates("--ca", file)?),
        };
        Ok(ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(timeout))
            .tls_config(TlsConfig::builder().root_certs(authorities).build())
            .build()
            .into())
    }

    /// Returns the URL of a path of the API.
    pub(super) fn address(&self, path: &str) -> String {
        format!("{}/v1/{path}", self.url.trim_end_matches('/'))
    }

    /// Adds the token to a request.
    pub(super) fn authorized<B>(&self, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        match self.token.clone().or_else(|| std::env::var("FLANKWATCH_TOKEN").ok()) {
            Some(token) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        }
    }
}

/// Checks the URL of a server, which must be complete.
fn server_url(text: &str) -> Result<String, String> {
    let is_usable = text.parse::<ureq::http::Uri>().is_ok_and(|uri| {
        matches!(uri.scheme_str(), Some("http" | "https")) && uri.host().is_some() && uri.query().is_none()
    });
    match is_usable {
        true => Ok(text.to_owned()),
        false => Err("expected a URL with http:// or https:// such as http://127.0.0.1:8600".to_owned()),
    }
}

/// Describes an unsuccessful response: its status, and the detail of the problem if its body is one.
pub(super) fn refusal(status: u16, body: &str) -> String {
    let problem = serde_json::from_str::<serde_json::Value>(body).ok();
    let detail = problem.as_ref().and_then(|problem| problem["detail"].as_str()).unwrap_or(body.trim());
    format!("the server answered {status}: {detail}")
}

/// Describes why a request has no response; also returns whether another attempt may have one.
pub(super) fn failure(error: &ureq::Error) -> (String, bool) {
    let of_tls = match error {
        ureq::Error::Rustls(error) => Some(error),
        ureq::Error::Io(error) => error.get_ref().and_then(|error| error.downcast_ref::<rustls::Error>()),
        _ => None,
    };
    match (of_tls, error) {
        (Some(of_tls), _) => (tls_failure(of_tls), false),
        (None, ureq::Error::Protocol(cause)) => {
            (format!("the answer is not HTTP ({cause}): a server with TLS needs a URL with https://"), false)
        }
        (None, error) => (error.to_string(), true),
    }
}

fn tls_failure(error: &rustls::Error) -> String {
    match error {
        rustls::Error::InvalidCertificate(CertificateError::UnknownIssuer) => {
            "the server's certificate is of an unknown authority, expected one of the file of --ca, or without \
             --ca a public one"
                .to_owned()
        }
        rustls::Error::InvalidCertificate(cause) if format!("{cause:?}").contains("CaUsedAsEndEntity") => {
            "the server's certificate is that of an authority, expected that of a server: make it with openssl \
             req … -addext basicConstraints=critical,CA:FALSE"
                .to_owned()
        }
        rustls::Error::InvalidCertificate(cause) => format!("the server's certificate is invalid: {cause}"),
        rustls::Error::InvalidMessage(_) => {
            "the server does not use TLS, expected a URL with http://".to_owned()
        }
        error => format!("no TLS connection: {error}"),
    }
}

/// Returns a successful response.
pub(super) fn success(
    url: &str,
    result: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
) -> Result<ureq::http::Response<ureq::Body>, CliError> {
    let failed = |reason: String| CliError::Server { url: url.to_owned(), reason };
    let mut response = result.map_err(|error| failed(failure(&error).0))?;
    let status = response.status();
    if !status.is_success() {
        let body = response.body_mut().read_to_string().unwrap_or_default();
        return Err(failed(refusal(status.as_u16(), &body)));
    }
    Ok(response)
}

/// Returns the body of a successful response.
pub(super) fn success_body(
    url: &str,
    result: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
) -> Result<String, CliError> {
    Ok(success(url, result)?.body_mut().read_to_string().unwrap_or_default())
}

/// Checks the time range of records, which no record is in if it is reversed.
pub(super) fn check_range(from: Option<Timestamp>, to: Option<Timestamp>) -> Result<(), CliError> {
    match from.zip(to).filter(|(from, to)| from >= to) {
        Some((from, to)) => Err(CliError::argument("--to", to, format!("a time after --from, {from}"))),
        None => Ok(()),
    }
}

pub(in crate::cli) fn asset_id(text: &str) -> Result<AssetId, CliError> {
    AssetId::new(text.to_owned()).map_err(|error| CliError::Argument(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_is_complete() {
        for url in ["http://127.0.0.1:8600", "https://watch.example/flankwatch/"] {
            assert_eq!(server_url(url).unwrap(), url);
        }
        for url in ["127.0.0.1:8600", "localhost", "ftp://x", "http://", "http:// x", "http://x?a=b", ""] {
            assert!(server_url(url).unwrap_err().contains("http://"), "{url}");
        }
    }

    #[test]
    fn a_refusal_has_the_detail_of_the_problem() {
        let problem = r#"{"type":"about:blank","status":404,"detail":"asset \"x\" not found"}"#;
        assert_eq!(refusal(404, problem), "the server answered 404: asset \"x\" not found");
        assert_eq!(refusal(502, "Bad gateway\n"), "the server answered 502: Bad gateway");
    }
}
