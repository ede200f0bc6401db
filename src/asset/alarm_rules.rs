//! The alarm rules of an asset: those of its description, or those derived from its limits.

use super::error::{AssetError, field};
use super::spec::AssetSpec;
use super::wear_limits::WearLimits;
use crate::estimate::{AlarmError, AlarmQuantity, AlarmRule};
use crate::signal::{BearingLine, Indicators, VELOCITY_RMS};

/// Maximum number of rules of an asset: each has a state in every stored state of the fold.
const MAX_RULES: usize = 32;

/// Hysteresis of a rule derived from limits, as a fraction of the lower limit.
const HYSTERESIS: f64 = 0.05;

/// The novelty from which a record counts as unexplained (a p-value of 10⁻⁴), and the hysteresis.
const NOVELTY_WARNING: f64 = 4.0;
const NOVELTY_HYSTERESIS: f64 = 1.0;

/// Ratio of a bearing's line to its background from which it counts as significant: none of 400 lines in
/// noise reached 2.9.
const BEARING_WARNING: f64 = 3.0;
const BEARING_HYSTERESIS: f64 = 0.5;

impl AssetSpec {
    /// The alarm rules in force.
    pub fn alarm_rules(&self) -> Vec<AlarmRule> {
        self.alarms.clone().unwrap_or_else(|| self.default_rules())
    }

    /// The default rules: for a mesh those derived from its wear limits, for a machine without one those on
    /// novelty; for both those on velocity zones and bearing lines, if described.
    fn default_rules(&self) -> Vec<AlarmRule> {
        let mut rules = Vec::from_iter(wear_rule(&self.limits));
        if !rules.is_empty() || self.gear.is_none() {
            rules.extend([AlarmQuantity::Novelty, AlarmQuantity::JointNovelty].map(|quantity| AlarmRule {
                warning: Some(NOVELTY_WARNING),
                hysteresis: NOVELTY_HYSTERESIS,
                ..AlarmRule::of(quantity)
            }));
        }
        if let Some(zones) = self.velocity_zones {
            let [_, warning, danger] = zones.limits_mm_per_s();
            rules.push(AlarmRule {
                warning: Some(warning),
                danger: Some(danger),
                hysteresis: hysteresis_at(warning),
                ..AlarmRule::of(AlarmQuantity::Indicator(VELOCITY_RMS.to_owned()))
            });
        }
        let bearings = self.bearings();
        let lines = bearings.iter().flat_map(|bearing| {
            BearingLine::ALL.map(|line| AlarmQuantity::Indicator(bearing.ratio_indicator(line)))
        });
        rules.extend(lines.map(|quantity| AlarmRule {
            warning: Some(BEARING_WARNING),
            hysteresis: BEARING_HYSTERESIS,
            ..AlarmRule::of(quantity)
        }));
        rules
    }

    /// Checks one rule; a field at fault is one of `alarms`.
    pub fn check_rule(&self, rule: &AlarmRule) -> Result<(), AssetError> {
        if let Some(name) = rule.quantity.indicator() {
            check_indicator(name, self)?;
        } else if rule.quantity.is_wear() && self.gear.is_none() {
            let expected = "a quantity other than wear: no gear is described";
            return Err(field("alarms.quantity", &rule.quantity, expected));
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
            AlarmError::NoRateWindow => {
                field("alarms.over_s", "missing", "the number of seconds over which the change is measured")
            }
            AlarmError::NoLevel | AlarmError::State { .. } => {
                field("alarms", &rule.quantity, "a warning or a danger level for each quantity")
            }
        })
    }
}

/// The hysteresis of a rule derived from limits, of which this is the lower one.
fn hysteresis_at(limit: f64) -> f64 {
    let hysteresis = HYSTERESIS * limit;
    // People read it: 5 % of 2.8 is 0.13999999999999999.
    format!("{hysteresis:.11e}").parse().unwrap_or(hysteresis)
}

fn wear_rule(limits: &WearLimits) -> Option<AlarmRule> {
    let WearLimits { warning_um, danger_um } = *limits;
    let lower = warning_um.or(danger_um)?;
    Some(AlarmRule {
        // A warning at the same depth as danger is redundant.
        warning: warning_um.filter(|warning| danger_um.is_none_or(|danger| *warning < danger)),
        danger: danger_um,
        hysteresis: hysteresis_at(lower),
        ..AlarmRule::of(AlarmQuantity::WearUm)
    })
}

pub(super) fn validate(spec: &AssetSpec) -> Result<(), AssetError> {
    let rules = spec.alarms.as_deref().unwrap_or_default();
    if rules.len() > MAX_RULES {
        return Err(field("alarms", format!("a list of {}", rules.len()), "at most 32 rules"));
    }
    for (index, rule) in rules.iter().enumerate() {
        if rules[..index].iter().any(|other| other.quantity == rule.quantity) {
            return Err(field("alarms.quantity", &rule.quantity, "each quantity at most once"));
        }
        spec.check_rule(rule)?;
    }
    Ok(())
}

/// Checks the name of an indicator: an alarm on one that no record has would never be raised.
fn check_indicator(name: &str, spec: &AssetSpec) -> Result<(), AssetError> {
    let names = spec.indicator_names();
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
    fn rules_are_derived_from_limits_unless_they_are_given() {
        assert!(spec("").unwrap().alarm_rules().is_empty());
        let rules = spec("limits = { warning_um = 100, danger_um = 200 }").unwrap().alarm_rules();
        assert_eq!(
            (rules.len(), rules[0].warning, rules[0].danger, rules[0].hysteresis),
            (3, Some(100.0), Some(200.0), 5.0)
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
    fn rules_are_derived_from_zones_and_bearings_of_a_machine_without_a_mesh() {
        let of_shaft =
            |shaft: &str, text: &str| AssetSpec::from_toml(&format!("id = \"fan\"\nshaft = {shaft}\n{text}"));
        let spec = |text: &str| of_shaft("{}", text);
        let rules = spec(
            "velocity_zones = { machine_class = \"group_2_rigid\" }\n[[bearings]]\nname = \"de\"\n\
             orders = { bpfo = 3.5, bpfi = 5.5, bsf = 2.3, ftf = 0.4 }",
        )
        .unwrap()
        .alarm_rules();
        let named: Vec<String> = rules.iter().map(|rule| rule.quantity.to_string()).collect();
        assert_eq!(named.len(), 7, "{named:?}");
        assert_eq!(named[..3], ["novelty", "joint_novelty", "indicator:velocity_rms"]);
        assert!(named.contains(&"indicator:bearing_de_bpfo_to_background".to_owned()), "{named:?}");
        assert_eq!((rules[2].warning, rules[2].danger), (Some(2.8), Some(4.5)));
        assert_eq!(rules[2].hysteresis, 0.14);
        assert!(rules.iter().all(|rule| rule.validate().is_ok()));
        for (text, name) in [
            ("limits = { danger_um = 100 }", "limits.danger_um"),
            ("alarms = [{ quantity = \"wear_um\", warning = 1 }]", "alarms.quantity"),
            ("alarms = [{ quantity = { indicator = \"fm4\" }, warning = 1 }]", "alarms.quantity.indicator"),
            ("[gear]\nteeth = [24, 36]\nshaft_speed_hz = 10", "shaft"),
        ] {
            match spec(text) {
                Err(AssetError::Field { field, .. }) => assert_eq!(field, name, "{text}"),
                other => panic!("{text}: {other:?}"),
            }
        }
        for shaft in ["{ speed_hz = 0 }", "{ speed_is_exact = true }"] {
            let error = of_shaft(shaft, "").unwrap_err().to_string();
            assert!(error.starts_with("shaft.speed_hz is"), "{error}");
        }
        let neither = AssetSpec::from_toml("id = \"fan\"").unwrap_err().to_string();
        assert_eq!(neither, "gear is missing, expected a mesh, or shaft for a machine without one");
    }

    #[test]
    fn errors_in_rules_name_their_field() {
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
