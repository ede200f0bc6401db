//! `--mqtt` and the environment of `flankwatch serve`.

use clap::Args;

#[cfg(feature = "mqtt")]
use crate::mqtt::{MqttCredentials, MqttSettings, MqttTable};
use crate::settings::SettingError;

/// Records from an MQTT broker.
#[derive(Debug, Clone, Default, Args)]
pub(in crate::cli) struct MqttArgs {
    /// MQTT broker to receive records from: mqtt://HOST[:1883] or mqtts://HOST[:8883].
    ///
    /// The table `mqtt` of the settings file has further options.
    #[arg(long = "mqtt", value_name = "URL")]
    url: Option<String>,
}

#[cfg(not(feature = "mqtt"))]
impl MqttArgs {
    /// Returns an error if a broker is given, as this program was built without MQTT.
    pub(super) fn refuse(&self) -> Result<(), SettingError> {
        match &self.url {
            None => Ok(()),
            Some(_) => Err(SettingError::WithoutFeature { field: "--mqtt", feature: "mqtt" }),
        }
    }
}

#[cfg(feature = "mqtt")]
impl MqttArgs {
    /// Merges the option with the settings file's table; `None` where neither names a broker.
    /// `max_bytes` is the largest record accepted.
    pub(super) fn resolve(
        &self,
        table: Option<MqttTable>,
        max_bytes: usize,
    ) -> Result<Option<MqttSettings>, SettingError> {
        if table.is_none() && self.url.is_none() {
            return Ok(None);
        }
        let mut table = table.unwrap_or_default();
        table.url = self.url.clone().or(table.url);
        let env = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
        let credentials = MqttCredentials {
            client_id: env("FLANKWATCH_MQTT_CLIENT_ID"),
            username: env("FLANKWATCH_MQTT_USERNAME"),
            password: env("FLANKWATCH_MQTT_PASSWORD"),
        };
        table.resolve(credentials, max_bytes).map(Some)
    }
}
