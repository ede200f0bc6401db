//! Which alarms an asset has: those that its description gives, or those that follow from its limits.

use super::spec::field;
use super::{AssetError, AssetSpec, WearLimits};
use crate::estimate::{AlarmError, AlarmQuantity, AlarmRule, AlarmSettings};

/// The most rules of an asset: each has a state with every kept state of the fold.
const MAX_RULES: usize = 32;

/// Hysteresis of the rule that follows from limits, as a part of the lower one.
const HYSTERESIS: f64 = 0.05;

/// The novelty from which records are not explained (a p-value of 10⁻⁴), and how far below it a record is again.
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
        quantity: AlarmQuantity::WearUm,
        // A warning at the same depth as danger says nothing.
        warning: warning_um.filter(|warning| danger_um.is_none_or(|danger| *warning < danger)),
        danger: danger_um,
        hysteresis: HYSTERESIS * lower,
        settings: AlarmSettings::default(),
    };
    let novelty = AlarmRule {
        quantity: AlarmQuantity::Novelty,
        warning: Some(NOVELTY_WARNING),
        danger: None,
        hysteresis: NOVELTY_HYSTERESIS,
        settings: AlarmSettings::default(),
    };
    vec![wear, novelty]
}

pub(super) fn validate(rules: &[AlarmRule]) -> Result<(), AssetError> {
    if rules.len() > MAX_RULES {
        return Err(field("alarms", format!("a list of {}", rules.len()), "at most 32 rules"));
    }
    for (index, rule) in rules.iter().enumerate() {
        if rules[..index].iter().any(|other| other.quantity == rule.quantity) {
            return Err(field("alarms.quantity", &rule.quantity, "every quantity once"));
        }
        if let AlarmQuantity::Indicator(name) = &rule.quantity
            && (name.is_empty() || name.len() > 64 || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'))
        {
            return Err(field(
                "alarms.quantity.indicator",
                format!("{name:?}"),
                "the name of an indicator: 1 to 64 letters, digits and _",
            ));
        }
        rule.validate().map_err(|error| match error {
            AlarmError::Field {
                field: name,
                value,
                expected,
            } => field(
                match name {
                    "warning" => "alarms.warning",
                    "danger" => "alarms.danger",
                    "hysteresis" => "alarms.hysteresis",
                    "raise" => "alarms.settings.raise",
                    "clear" => "alarms.settings.clear",
                    _ => "alarms",
                },
                value,
                expected,
            ),
            AlarmError::NoLevel | AlarmError::State { .. } => {
                field("alarms", &rule.quantity, "a warning or a danger level for each quantity")
            }
        })?;
    }
    Ok(())
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
        let given = spec("alarms = [{ quantity = { indicator = \"rms\" }, warning = 2.5 }]")
            .unwrap()
            .alarm_rules();
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
}
