//! Webhooks: requests signed by the Standard Webhooks specification (standardwebhooks.com).

use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use jiff::Timestamp;
use ring::hmac;
use ureq::tls::{RootCerts, TlsConfig};

use super::error::NotificationError;
use crate::settings::{Secret, SettingError};

/// Prefix of a webhook's secret, by Standard Webhooks.
const PREFIX: &str = "whsec_";

/// Length of a webhook's key in bytes.
const KEY_BYTES: std::ops::RangeInclusive<usize> = 24..=64;

/// A receiver of webhooks.
#[derive(Clone)]
pub(super) struct Webhook {
    agent: ureq::Agent,
    url: String,
    secret: Secret,
}

impl Webhook {
    /// Creates a webhook for a URL; `authorities` verify the server.
    pub(super) fn new(url: String, secret: Secret, authorities: RootCerts, timeout: Duration) -> Self {
        let config = ureq::Agent::config_builder()
            .http_status_as_error(false)
            // A signed request must not reach another receiver.
            .max_redirects(0)
            .timeout_global(Some(timeout))
            .tls_config(TlsConfig::builder().root_certs(authorities).build())
            .user_agent(concat!("flankwatch/", env!("CARGO_PKG_VERSION")))
            .build();
        Self { agent: config.into(), url, secret }
    }

    /// Sends a body under an identifier. Blocks.
    pub(super) fn send(&self, id: &str, body: &str, now: Timestamp) -> Result<(), NotificationError> {
        let seconds = now.as_second();
        let signature = signature(&key(&self.secret)?, id, seconds, body);
        let response = self
            .agent
            .post(&self.url)
            .header("content-type", "application/json")
            .header("webhook-id", id)
            .header("webhook-timestamp", seconds.to_string())
            .header("webhook-signature", signature)
            .send(body)
            .map_err(Box::new)?;
        let status = response.status();
        if status.is_success() { Ok(()) } else { Err(NotificationError::Status(status.as_u16())) }
    }
}

/// Decodes the key of the signature.
pub(super) fn key(secret: &Secret) -> Result<Vec<u8>, SettingError> {
    let text = secret.text()?;
    let key = text.strip_prefix(PREFIX).and_then(|text| STANDARD.decode(text).ok());
    key.filter(|key| KEY_BYTES.contains(&key.len())).ok_or_else(|| {
        // The value is not repeated: it is a secret.
        let expected = "whsec_ and 24 to 64 bytes in base64, as from `echo whsec_$(openssl rand -base64 32)`";
        SettingError::new(&secret.field, "invalid", expected)
    })
}

/// Returns the signature: HMAC-SHA256 of identifier, time and body.
fn signature(key: &[u8], id: &str, seconds: i64, body: &str) -> String {
    let key = hmac::Key::new(hmac::HMAC_SHA256, key);
    let tag = hmac::sign(&key, format!("{id}.{seconds}.{body}").as_bytes());
    format!("v1,{}", STANDARD.encode(tag))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signature_matches_the_specification() {
        // The example in the specification's libraries.
        let key = STANDARD.decode("MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw").unwrap();
        let signed =
            signature(&key, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, r#"{"test": 2432232314}"#);
        assert_eq!(signed, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }
}
