//! The server that a command sends requests to.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use ureq::tls::TlsConfig;

use super::CliError;
use super::replay::root_certificates;
use crate::asset::AssetId;

/// Address and credentials of a server.
#[derive(Args)]
pub(super) struct ServerArgs {
    /// URL of the server
    #[arg(long, default_value = "http://127.0.0.1:8600")]
    url: String,
    /// CA certificates (PEM) to verify the server with [default: the public CAs]
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// API token [default: the environment variable FLANKWATCH_TOKEN]
    #[arg(long)]
    token: Option<String>,
}

impl ServerArgs {
    pub(super) fn agent(&self) -> Result<ureq::Agent, CliError> {
        Ok(ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(600)))
            .tls_config(TlsConfig::builder().root_certs(root_certificates(self.ca.as_deref())?).build())
            .build()
            .into())
    }

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

/// Returns a successful response.
pub(super) fn success(
    url: &str,
    result: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
) -> Result<ureq::http::Response<ureq::Body>, CliError> {
    let failed = |reason: String| CliError::Server { url: url.to_owned(), reason };
    let mut response = result.map_err(|error| failed(error.to_string()))?;
    let status = response.status();
    if !status.is_success() {
        let body = response.body_mut().read_to_string().unwrap_or_default();
        return Err(failed(format!("the server answered {}: {body}", status.as_u16())));
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

pub(super) fn asset_id(text: &str) -> Result<AssetId, CliError> {
    AssetId::new(text.to_owned()).map_err(|error| CliError::Argument(error.to_string()))
}
