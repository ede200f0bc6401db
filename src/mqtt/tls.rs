//! TLS configuration of the connection to the broker.

use std::path::PathBuf;
use std::sync::Arc;

use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ClientConfig, RootCertStore};

use super::error::MqttError;

/// Certificates and keys as PEM files.
#[derive(Debug, Clone, Default)]
pub(super) struct TlsFiles {
    /// CA certificates to verify the broker with; default: those of the system.
    pub(super) ca_file: Option<PathBuf>,
    /// Client certificate and its key.
    pub(super) client: Option<(PathBuf, PathBuf)>,
}

impl TlsFiles {
    /// Reads the files.
    pub(super) fn config(&self) -> Result<ClientConfig, MqttError> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let ca_file = self.ca_file.clone().unwrap_or_default();
        let builder = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| MqttError::tls("ca_file", &ca_file, error))?
            .with_root_certificates(self.authorities()?);
        let config = match &self.client {
            None => builder.with_no_client_auth(),
            Some((certificate, key)) => {
                let chain: Result<Vec<_>, _> =
                    CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect);
                let chain = chain.map_err(|error| MqttError::tls("certificate", certificate, error))?;
                let private =
                    PrivateKeyDer::from_pem_file(key).map_err(|error| MqttError::tls("key", key, error))?;
                builder
                    .with_client_auth_cert(chain, private)
                    .map_err(|error| MqttError::tls("certificate", certificate, error))?
            }
        };
        Ok(config)
    }

    fn authorities(&self) -> Result<RootCertStore, MqttError> {
        let mut authorities = RootCertStore::empty();
        let Some(path) = &self.ca_file else {
            let found = rustls_native_certs::load_native_certs();
            authorities.add_parsable_certificates(found.certs);
            if authorities.is_empty() {
                let errors: Vec<String> = found.errors.iter().map(ToString::to_string).collect();
                return Err(MqttError::NoAuthorities(errors.join("; ")));
            }
            return Ok(authorities);
        };
        let certificates: Result<Vec<_>, _> = CertificateDer::pem_file_iter(path).and_then(Iterator::collect);
        for certificate in certificates.map_err(|error| MqttError::tls("ca_file", path, error))? {
            authorities.add(certificate).map_err(|error| MqttError::tls("ca_file", path, error))?;
        }
        if authorities.is_empty() {
            return Err(MqttError::tls("ca_file", path, "no certificate in it"));
        }
        Ok(authorities)
    }
}
