//! Which alarms an asset has: those that its description gives, or those that follow from its limits.

use super::spec::field;
use super::{AssetError, AssetSpec, WearLimits};
use crate::estimate::{AlarmError, AlarmQuantity, AlarmRule};
use crate::signal::{Band, Indicators};

/// The most rules of an asset: each has a state with every kept state of the fold.
const MAX_RULES: usize = 32;

/// Hysteresis of the rule that follows from limits, as a part of the lower one.
const HYSTERESIS: f64 = 0.05;

/// The novelty from which records are not explained (a p-value of 10⁻⁴), and how far below it a record is
/// again.
const NOVELTY_WARNING: f64 = 4.0;
const NOVELTY_HYSTERESIS: f64 = 1.0;

impl AssetSpec {
    /// The alarm rules in force.
    pub fn alarm_rules(&self) -> Vec<AlarmRule> {
        self.alarms.clone().unwrap_or_else(|| following_from(&self.limits))
    }
}

fn following_from(limits: &WearLimits) -> Vec<AlarmRule> {
    let WearLimits { warning_um, danger_um } = *limits;
    let Some(lower) = warning_um.or(danger_um) else {
        return Vec::new();
    };
    let wear = AlarmRule {
        // A warning at the same depth as danger says nothing.
        warning: warning_um.filter(|warning| danger_um.is_none_or(|danger| *warning < danger)),
        danger: danger_um,
        hysteresis: HYSTERESIS * lower,
        ..AlarmRule::of(AlarmQuantity::WearUm)
    };
    let novelty = AlarmRule {
        warning: Some(NOVELTY_WARNING),
        hysteresis: NOVELTY_HYSTERESIS,
        ..AlarmRule::of(AlarmQuantity::Novelty)
    };
    vec![wear, novelty]
}

pub(super) fn validate(rules: &[AlarmRule], bands: &[Band]) -> Result<(), AssetError> {
    if rules.len() > MAX_RULES {
        return Err(field("alarms", format!("a list of {}", rules.len()), "at most 32 rules"));
    }
    for (index, rule) in rules.iter().enumerate() {
        if rules[..index].iter().any(|other| other.quantity == rule.quantity) {
            return Err(field("alarms.quantity", &rule.quantity, "every quantity once"));
        }
        if let Some(name) = rule.quantity.indicator() {
            check_indicator(name, bands)?;
        }
        rule.validate().map_err(|error| match error {
            AlarmError::Field { field: name, value, expected } => field(
                match name {
                    "warning" => "alarms.warning",
                    "danger" => "alarms.danger",
                    "warning_below" => "alarms.warning_below",
                    "danger_below" => "alarms.danger_below",
                    "hysteresis" => "alarms.hysteresis",
                    "over_s" => "alarms.over_s",
                    "raise" => "alarms.settings.raise",
                    "clear" => "alarms.settings.clear",
                    _ => "alarms",
                },
                value,
                expected,
            ),
            AlarmError::NoStretch => {
                field("alarms.over_s", "missing", "the number of seconds over which the change is measured")
            }
            AlarmError::NoLevel | AlarmError::State { .. } => {
                field("alarms", &rule.quantity, "a warning or a danger level for each quantity")
            }
        })?;
    }
    Ok(())
}

/// A rule on an indicator that no record ever has would never be raised.
fn check_indicator(name: &str, bands: &[Band]) -> Result<(), AssetError> {
    let names = Indicators::names(bands);
    if names.iter().any(|known| known == name) {
        return Ok(());
    }
    let nearest = Indicators::nearest(name, names.iter().map(String::as_str)).join(", ");
    let value = format!("{:?}", name.chars().take(64).collect::<String>());
    let expected = format!("the name of an indicator; the nearest are {nearest}");
    Err(field("alarms.quantity.indicator", value, expected))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(text: &str) -> Result<AssetSpec, AssetError> {
        AssetSpec::from_toml(&format!("id = \"a\"\n{text}\n[gear]\nteeth = [24, 36]\nshaft_speed_hz = 16.6"))
    }

    #[test]
    fn rules_follow_from_limits_unless_they_are_given() {
        assert!(spec("").unwrap().alarm_rules().is_empty());
        let rules = spec("limits = { warning_um = 100, danger_um = 200 }").unwrap().alarm_rules();
        assert_eq!(
            (rules.len(), rules[0].warning, rules[0].danger, rules[0].hysteresis),
            (2, Some(100.0), Some(200.0), 5.0)
        );
        assert!(rules.iter().all(|rule| rule.validate().is_ok()));
        let alike = spec("limits = { warning_um = 200, danger_um = 200 }").unwrap().alarm_rules();
        assert_eq!((alike[0].warning, alike[0].danger), (None, Some(200.0)));
        assert!(alike[0].validate().is_ok());
        assert!(spec("alarms = []\nlimits = { warning_um = 100 }").unwrap().alarm_rules().is_empty());
        let given =
            spec("alarms = [{ quantity = { indicator = \"rms\" }, warning = 2.5 }]").unwrap().alarm_rules();
        assert_eq!(given[0].quantity, AlarmQuantity::Indicator("rms".into()));
    }

    #[test]
    fn rules_that_cannot_be_used_name_their_field() {
        for (rules, name) in [
            ("{ quantity = \"wear_um\" }", "alarms"),
            ("{ quantity = \"wear_um\", warning = 2, danger = 1 }", "alarms.danger"),
            ("{ quantity = \"novelty\", warning = nan }", "alarms.warning"),
            ("{ quantity = \"novelty\", warning = 1, hysteresis = -1 }", "alarms.hysteresis"),
            (
                "{ quantity = \"novelty\", warning = 1, settings = { raise = 3, raise_of = 2, clear = 1, clear_of = 1 } }",
                "alarms.settings.raise",
            ),
            ("{ quantity = { indicator = \"\" }, warning = 1 }", "alarms.quantity.indicator"),
            ("{ quantity = \"novelty\", warning = 1e308 }", "alarms.warning"),
            ("{ quantity = \"wear_um\", danger_below = 2, warning_below = 1 }", "alarms.danger_below"),
            ("{ quantity = { rate_per_day = \"wear_um\" }, warning = 1 }", "alarms.over_s"),
            (
                "{ quantity = { rate_per_day = { indicator = \"rsm\" } }, warning = 1, over_s = 60 }",
                "alarms.quantity.indicator",
            ),
            ("{ quantity = \"sensor_fault\", danger = 1 }", "alarms.danger"),
            ("{ quantity = \"stale_s\", warning_below = 1 }", "alarms.warning_below"),
            (
                "{ quantity = \"novelty\", warning = 1 }, { quantity = \"novelty\", danger = 2 }",
                "alarms.quantity",
            ),
        ] {
            match spec(&format!("alarms = [{rules}]")) {
                Err(AssetError::Field { field, .. }) => assert_eq!(field, name, "{rules}"),
                other => panic!("{rules}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_misspelt_indicator_is_refused_with_the_nearest_names() {
        let error = spec("alarms = [{ quantity = { indicator = \"kurtsosis\" }, warning = 4 }]")
            .unwrap_err()
            .to_string();
        assert!(error.contains("\"kurtsosis\"") && error.contains("the nearest are kurtosis"), "{error}");
        let bands = "bands = [{ name = \"low\", band_hz = [10, 1000] }]";
        let of_band = |name: &str| {
            spec(&format!("alarms = [{{ quantity = {{ indicator = \"{name}\" }}, warning = 4 }}]\n{bands}"))
        };
        assert!(of_band("band_low").is_ok());
        assert!(of_band("band_lwo").unwrap_err().to_string().contains("band_low"));
    }
}
