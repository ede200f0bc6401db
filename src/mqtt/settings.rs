//! The table `[mqtt]` of the settings file.

use std::fmt::Display;
use std::path::PathBuf;
use std::time::Duration;

use axum::http::Uri;
use rumqttc::v5::MqttOptions;
use rumqttc::v5::mqttbytes::v5::ConnectProperties;
use rumqttc::{NetworkOptions, Transport};
use serde::Deserialize;

use super::error::MqttError;
use super::tls::TlsFiles;
use crate::settings::{Secret, SettingError, host_and_port};

/// Maximum packet size of MQTT: a message that is too large for a record must still be read, so that its
/// sender gets a rejection.
const MAX_PACKET_BYTES: u32 = 268_435_455 + 5;

/// Timeout for establishing a connection.
const CONNECTION_TIMEOUT_S: u64 = 10;

/// The table `mqtt` of the settings file.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MqttTable {
    /// `mqtt://host[:1883]` or `mqtts://host[:8883]`.
    pub url: Option<String>,
    /// Client identifier, which names the persistent session; unique among the nodes.
    pub client_id: Option<String>,
    /// User name at the broker.
    pub username: Option<String>,
    /// File with the user's password.
    pub password_file: Option<PathBuf>,
    /// CA certificates (PEM) to verify the broker with; default: those of the system.
    pub ca_file: Option<PathBuf>,
    /// Client certificate (PEM); requires `key`.
    pub certificate: Option<PathBuf>,
    /// Private key (PEM) of the certificate.
    pub key: Option<PathBuf>,
    /// First levels of the topics.
    pub root: Option<String>,
    /// Name of a shared subscription, whose messages are distributed among the nodes.
    pub share: Option<String>,
    /// Maximum number of unacknowledged messages.
    pub in_flight: Option<u16>,
    /// Maximum size of a message in bytes.
    pub message_bytes: Option<usize>,
    /// Time for which the broker keeps messages of a disconnected service, in seconds.
    pub session_expiry_s: Option<u32>,
    /// MQTT keep-alive interval in seconds.
    pub keep_alive_s: Option<u16>,
}

/// Credentials of the environment; they override the settings file.
#[derive(Debug, Clone, Default)]
pub struct MqttCredentials {
    /// Client identifier, which names the persistent session.
    pub client_id: Option<String>,
    /// User name at the broker.
    pub username: Option<String>,
    /// The user's password.
    pub password: Option<String>,
}

/// Settings of a feed from an MQTT broker.
#[derive(Clone)]
pub struct MqttSettings {
    host: String,
    port: u16,
    client_id: String,
    login: Option<Login>,
    tls: Option<TlsFiles>,
    pub(super) root: String,
    pub(super) share: Option<String>,
    /// Maximum number of unacknowledged messages.
    pub in_flight: u16,
    /// Maximum size of a message in bytes; larger ones are rejected.
    pub message_bytes: usize,
    session_expiry_s: u32,
    pub(super) keep_alive: Duration,
}

#[derive(Clone)]
struct Login {
    username: String,
    password: Secret,
}

impl MqttTable {
    /// Resolves the table with the credentials of the environment. `max_bytes` is the largest record that the
    /// service accepts.
    ///
    /// # Errors
    /// [`SettingError`] with the setting, its value and what was expected.
    pub fn resolve(
        self,
        credentials: MqttCredentials,
        max_bytes: usize,
    ) -> Result<MqttSettings, SettingError> {
        let url = self.url.unwrap_or_default();
        let (is_tls, host, port) = parse_url(&url)?;
        let lacks = |field| Err(invalid(field, "missing", "both certificate and key or neither"));
        let client = match (self.certificate, self.key) {
            (None, None) => None,
            (Some(certificate), Some(key)) => Some((certificate, key)),
            (Some(_), None) => return lacks("key"),
            (None, Some(_)) => return lacks("certificate"),
        };
        let tls = TlsFiles { ca_file: self.ca_file, client };
        if !is_tls && (tls.ca_file.is_some() || tls.client.is_some()) {
            return Err(invalid("url", url, "mqtts://…, where certificates are given"));
        }
        let share = self.share;
        let client_id = match (credentials.client_id.or(self.client_id), &share) {
            (Some(id), _) => id,
            (None, None) => "flankwatch".to_owned(),
            (None, Some(_)) => {
                let expected =
                    "a unique name for each node of the shared subscription, the same after a restart";
                return Err(invalid("client_id", "missing", expected));
            }
        };
        let settings = MqttSettings {
            host,
            port,
            client_id,
            login: login(credentials.username.or(self.username), credentials.password, self.password_file)?,
            tls: is_tls.then_some(tls),
            root: self.root.unwrap_or_else(|| "flankwatch".to_owned()),
            share,
            in_flight: self.in_flight.unwrap_or(16),
            message_bytes: self.message_bytes.unwrap_or(max_bytes.min(16 << 20)),
            session_expiry_s: self.session_expiry_s.unwrap_or(7 * 24 * 3600),
            keep_alive: Duration::from_secs(self.keep_alive_s.unwrap_or(30).into()),
        };
        settings.check(max_bytes)?;
        Ok(settings)
    }
}

impl MqttSettings {
    fn check(&self, max_bytes: usize) -> Result<(), SettingError> {
        let is_level = |name: &str| !name.is_empty() && !name.contains(['+', '#', '\0']);
        if !self.root.split('/').all(is_level) || self.root.starts_with('$') {
            let expected = "levels of a topic, none of them empty, without + and #";
            return Err(invalid("root", &self.root, expected));
        }
        if let Some(share) = self.share.as_deref().filter(|share| !is_level(share) || share.contains('/')) {
            return Err(invalid("share", share, "a name without /, + and #"));
        }
        if !(1..=1024).contains(&self.in_flight) {
            return Err(invalid("in_flight", self.in_flight, "1 to 1024 messages"));
        }
        if !(1..=max_bytes).contains(&self.message_bytes) {
            let expected = "at least 1 and at most limits.record_bytes";
            return Err(invalid("message_bytes", self.message_bytes, expected));
        }
        if self.session_expiry_s == 0 {
            let expected =
                "at least 1: without a session the broker keeps no messages while the service is down";
            return Err(invalid("session_expiry_s", 0, expected));
        }
        // The client library's minimum.
        if self.keep_alive.as_secs() < 5 {
            return Err(invalid("keep_alive_s", self.keep_alive.as_secs(), "at least 5"));
        }
        if self.client_id.is_empty() || self.client_id.len() > 128 {
            return Err(invalid("client_id", &self.client_id, "a name of 1 to 128 bytes"));
        }
        Ok(())
    }

    /// Returns the client identifier.
    pub(super) fn client_id(&self) -> &str {
        &self.client_id
    }

    /// Returns the broker's address, for log lines.
    pub(super) fn broker(&self) -> String {
        format!("{}:{}", self.host, self.port)
    }

    /// Returns the client library's options. Reads password and certificates each time, so that a changed
    /// file takes effect with the next connection.
    pub(super) fn options(&self) -> Result<MqttOptions, MqttError> {
        let mut options = MqttOptions::new(&self.client_id, &self.host, self.port);
        let mut properties = ConnectProperties::new();
        properties.session_expiry_interval = Some(self.session_expiry_s);
        properties.receive_maximum = Some(self.in_flight);
        properties.max_packet_size = Some(MAX_PACKET_BYTES);
        let mut network = NetworkOptions::new();
        network.set_tcp_nodelay(true);
        options
            .set_clean_start(false)
            .set_manual_acks(true)
            .set_keep_alive(self.keep_alive)
            .set_connection_timeout(CONNECTION_TIMEOUT_S)
            .set_outgoing_inflight_upper_limit(self.in_flight)
            .set_connect_properties(properties)
            .set_network_options(network);
        if let Some(login) = &self.login {
            options.set_credentials(&login.username, login.password.text()?);
        }
        if let Some(tls) = &self.tls {
            options.set_transport(Transport::tls_with_config(tls.config()?.into()));
        }
        Ok(options)
    }
}

fn login(
    username: Option<String>,
    password: Option<String>,
    file: Option<PathBuf>,
) -> Result<Option<Login>, SettingError> {
    let password = Secret::new("mqtt.password_file".to_owned(), password, file);
    match (username, password) {
        (None, None) => Ok(None),
        (Some(username), Some(password)) => Ok(Some(Login { username, password })),
        (Some(_), None) => Err(invalid("password_file", "missing", "a password for the user")),
        (None, Some(_)) => Err(invalid("username", "missing", "the user of the password")),
    }
}

/// Parses a URL into whether it uses TLS, the host and the port.
fn parse_url(url: &str) -> Result<(bool, String, u16), SettingError> {
    const EXPECTED: &str = "mqtt://host[:port] or mqtts://host[:port], with a port from 1 to 65535";
    let unusable = |value: &str| invalid("url", value, EXPECTED);
    if url.is_empty() {
        return Err(unusable("missing"));
    }
    let uri: Uri = url.parse().map_err(|_| unusable(url))?;
    let authority = uri.authority().ok_or_else(|| unusable(url))?;
    if authority.as_str().contains('@') {
        // The URL is not repeated in the message: it may contain a password.
        let expected = "no user in it: set FLANKWATCH_MQTT_USERNAME and FLANKWATCH_MQTT_PASSWORD, or username and password_file";
        return Err(invalid("url", "a URL with a user", expected));
    }
    let is_tls = match uri.scheme_str() {
        Some("mqtt") => false,
        Some("mqtts") => true,
        _ => return Err(unusable(url)),
    };
    let (host, port) = host_and_port(&uri).ok_or_else(|| unusable(url))?;
    if !matches!(uri.path(), "" | "/") || uri.query().is_some() {
        return Err(unusable(url));
    }
    Ok((is_tls, host.to_owned(), port.unwrap_or(if is_tls { 8883 } else { 1883 })))
}

fn invalid(field: &str, value: impl Display, expected: &str) -> SettingError {
    SettingError::new(format!("mqtt.{field}"), value, expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(text: &str) -> Result<MqttSettings, String> {
        let table: MqttTable = toml::from_str(text).map_err(|error| error.to_string())?;
        table.resolve(MqttCredentials::default(), 1 << 20).map_err(|error| error.to_string())
    }

    #[test]
    fn the_url_is_sufficient() {
        let settings = resolve(r#"url = "mqtt://broker""#).unwrap();
        assert_eq!((settings.broker().as_str(), settings.root.as_str()), ("broker:1883", "flankwatch"));
        assert_eq!(settings.message_bytes, 1 << 20, "at most the service's limit");
        assert_eq!(resolve(r#"url = "mqtts://broker""#).unwrap().broker(), "broker:8883");
        assert_eq!(resolve(r#"url = "mqtts://10.0.0.1:99/""#).unwrap().broker(), "10.0.0.1:99");
    }

    #[test]
    fn the_environment_overrides_the_file() {
        let table: MqttTable =
            toml::from_str("url = \"mqtt://b\"\nusername = \"file\"\nclient_id = \"file\"").unwrap();
        let credentials = MqttCredentials {
            client_id: Some("node-2".into()),
            username: Some("env".into()),
            password: Some("secret".into()),
        };
        let options = table.resolve(credentials, 1 << 20).unwrap().options().unwrap();
        assert_eq!(options.client_id(), "node-2");
        let login = options.credentials().unwrap();
        assert_eq!((login.username.as_str(), login.password.as_str()), ("env", "secret"));
    }

    #[test]
    fn errors_name_the_setting_but_no_secret() {
        for (text, words) in [
            ("", "mqtt.url is missing"),
            (r#"url = "http://broker""#, "mqtts://host"),
            (r#"url = "mqtt://user:secret@broker""#, "no user in it"),
            (r#"url = "mqtt://broker/topic""#, "mqtt.url"),
            (r#"url = "mqtt://broker:99999""#, "mqtt.url is mqtt://broker:99999"),
            (r#"url = "mqtt://broker:0""#, "from 1 to 65535"),
            ("url = \"mqtt://b\"\nroot = \"plant/\"", "mqtt.root is plant/"),
            ("url = \"mqtt://b\"\nclient_id = \"\"", "mqtt.client_id is empty"),
            ("url = \"mqtt://b\"\nca_file = \"ca.pem\"", "mqtts://"),
            ("url = \"mqtts://b\"\ncertificate = \"c.pem\"", "mqtt.key is missing"),
            ("url = \"mqtt://b\"\nshare = \"nodes\"", "mqtt.client_id is missing"),
            ("url = \"mqtt://b\"\nshare = \"a/b\"\nclient_id = \"1\"", "mqtt.share is a/b"),
            ("url = \"mqtt://b\"\nroot = \"a/+\"", "mqtt.root is a/+"),
            ("url = \"mqtt://b\"\nin_flight = 0", "mqtt.in_flight is 0"),
            ("url = \"mqtt://b\"\nmessage_bytes = 2000000", "limits.record_bytes"),
            ("url = \"mqtt://b\"\nsession_expiry_s = 0", "session_expiry_s"),
            ("url = \"mqtt://b\"\nkeep_alive_s = 1", "keep_alive_s"),
            ("url = \"mqtt://b\"\nusername = \"u\"", "password_file"),
            ("url = \"mqtt://b\"\npassword_file = \"p\"", "mqtt.username is missing"),
            ("url = \"mqtt://b\"\nqos = 2", "unknown field `qos`"),
        ] {
            let error = resolve(text).map(|_| ()).unwrap_err();
            assert!(error.contains(words), "{text}: {error}");
            assert!(!error.contains("secret"), "{error}");
        }
        let missing = resolve("url = \"mqtts://b\"\nca_file = \"/nowhere/ca.pem\"").unwrap();
        let error = missing.options().map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("mqtt.ca_file") && error.contains("/nowhere/ca.pem"), "{error}");
    }
}
