//! `--mqtt` and the environment of `flankwatch serve`.

use clap::Args;

#[cfg(not(feature = "mqtt"))]
use super::serve::ServeError;
#[cfg(feature = "mqtt")]
use crate::mqtt::{MqttCredentials, MqttError, MqttSettings, MqttTable};

/// Records from an MQTT broker.
#[derive(Debug, Clone, Default, Args)]
pub(super) struct MqttArgs {
    /// Broker whose messages are taken as records, mqtt://HOST[:1883] or mqtts://HOST[:8883]; the table mqtt
    /// of the settings file says more.
    #[arg(long = "mqtt", value_name = "URL")]
    url: Option<String>,
}

#[cfg(not(feature = "mqtt"))]
impl MqttArgs {
    /// Says that this program knows no brokers.
    pub(super) fn refuse(&self) -> Result<(), ServeError> {
        match &self.url {
            None => Ok(()),
            Some(_) => Err(ServeError::WithoutFeature { what: "--mqtt", feature: "mqtt" }),
        }
    }
}

#[cfg(feature = "mqtt")]
impl MqttArgs {
    /// The settings that follow with the settings file's table; none where neither names a broker.
    /// `max_bytes` is the largest record taken.
    pub(super) fn resolve(
        &self,
        table: Option<MqttTable>,
        max_bytes: usize,
    ) -> Result<Option<MqttSettings>, MqttError> {
        if table.is_none() && self.url.is_none() {
            return Ok(None);
        }
        let mut table = table.unwrap_or_default();
        table.url = self.url.clone().or(table.url);
        let said = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
        let credentials = MqttCredentials {
            client_id: said("FLANKWATCH_MQTT_CLIENT_ID"),
            username: said("FLANKWATCH_MQTT_USERNAME"),
            password: said("FLANKWATCH_MQTT_PASSWORD"),
        };
        table.resolve(credentials, max_bytes).map(Some)
    }
}
