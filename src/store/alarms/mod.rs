//! Reading alarms: their states, their histories, and the operator actions on them.

pub(super) mod shelvings;
pub(super) mod silences;
pub(super) mod writing;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::Row;
use sqlx::any::AnyRow;

use self::writing::alarm_id;
use crate::asset::AssetId;
use crate::estimate::{Alarm, AlarmChange, AlarmQuantity, AlarmRule, AlarmState, PanelAction, Severity};
use crate::store::database::rows::{asset_id, from_json, from_ns, get, get_json, to_ns};
use crate::store::{ChannelSummary, Store, StoreError};

/// A stored alarm. An alarm is stored from its first change on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredAlarm {
    /// Identifier.
    pub id: String,
    /// The asset.
    pub asset_id: AssetId,
    /// The channel.
    pub channel: String,
    /// The quantity that it watches.
    pub quantity: AlarmQuantity,
    /// The rule; `None` if the asset no longer has it.
    pub rule: Option<AlarmRule>,
    /// Its state.
    pub alarm: Alarm,
    /// When its state last changed.
    pub changed_at: Timestamp,
}

/// An entry of an alarm's history.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = AlarmEntry)]
pub struct StoredAlarmChange {
    /// The entry itself.
    #[serde(flatten)]
    pub change: AlarmChange,
    /// When the entry was withdrawn because late records or a recomputation contradict it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub withdrawn_at: Option<Timestamp>,
}

/// Selects the alarms to be listed.
#[derive(Debug, Clone, Default)]
pub struct AlarmFilter {
    /// Only those of this asset.
    pub asset: Option<AssetId>,
    /// Only those of this channel.
    pub channel: Option<String>,
    /// Only those in one of these states; all if empty.
    pub states: Vec<AlarmState>,
    /// Only those raised with this severity.
    pub severity: Option<Severity>,
    /// Only those that changed before this time, or at it and have a lower identifier.
    pub after: Option<(Timestamp, String)>,
}

/// Alarms with their channels.
const ALARM: &str =
    "SELECT l.*, c.asset_id, c.name AS channel FROM alarms l JOIN channels c ON c.channel_no = l.channel_no";

/// The state at the time bound to `$1`.
const STATE: &str = "CASE WHEN l.shelved_until_ns > $1 THEN 'shelved' ELSE l.standing END";

impl StoredAlarm {
    /// The alarm of a channel's rule before its first change.
    pub fn untouched(channel: &ChannelSummary, rule: &AlarmRule, now: Timestamp) -> Self {
        Self {
            id: alarm_id(channel, &rule.quantity),
            asset_id: channel.asset_id.clone(),
            channel: channel.channel.clone(),
            quantity: rule.quantity.clone(),
            rule: Some(rule.clone()),
            alarm: Alarm::default(),
            changed_at: now,
        }
    }
}

impl Store {
    /// Lists up to `limit` alarms in their states at `now`, the one that changed last first.
    pub async fn alarms(
        &self,
        filter: &AlarmFilter,
        now: Timestamp,
        limit: u32,
    ) -> Result<Vec<StoredAlarm>, StoreError> {
        let mut text = format!("{ALARM} WHERE $1 = $1");
        // The bound texts, in the order of their numbers from 2 on.
        let mut bound: Vec<String> = Vec::new();
        let mut number = |value: &str| {
            bound.push(value.to_owned());
            bound.len() + 1
        };
        if let Some(asset) = &filter.asset {
            text += &format!(" AND c.asset_id = ${}", number(asset.as_str()));
        }
        if let Some(channel) = &filter.channel {
            text += &format!(" AND c.name = ${}", number(channel));
        }
        if let Some(severity) = filter.severity {
            text += &format!(" AND l.severity = ${}", number(severity.name()));
        }
        if !filter.states.is_empty() {
            let states: Vec<String> =
                filter.states.iter().map(|state| format!("${}", number(state.name()))).collect();
            text += &format!(" AND {STATE} IN ({})", states.join(", "));
        }
        if let Some((_, id)) = &filter.after {
            let id = number(id);
            text += &format!(" AND (l.changed_at_ns, l.id) < (${}, ${id})", bound.len() + 2);
        }
        let after = filter.after.as_ref().map(|(time, _)| to_ns(*time)).transpose()?;
        let last = bound.len() + 2 + usize::from(after.is_some());
        text += &format!(" ORDER BY l.changed_at_ns DESC, l.id DESC LIMIT ${last}");
        let query = sqlx::query(&text).bind(to_ns(now)?);
        let mut query = bound.into_iter().fold(query, |query, value| query.bind(value));
        if let Some(after) = after {
            query = query.bind(after);
        }
        let rows = query.bind(i64::from(limit)).fetch_all(self.read()).await?;
        rows.iter().map(alarm_of).collect()
    }

    /// Reads an alarm; returns `None` if there is none with that identifier.
    pub async fn alarm(&self, id: &str) -> Result<Option<StoredAlarm>, StoreError> {
        let text = format!("{ALARM} WHERE l.id = $1");
        let row = sqlx::query(&text).bind(id).fetch_optional(self.read()).await?;
        row.as_ref().map(alarm_of).transpose()
    }

    /// The alarms of these assets that are raised, unacknowledged or shelved.
    pub async fn open_alarms(&self, assets: &[&AssetId]) -> Result<Vec<StoredAlarm>, StoreError> {
        let text = |these: &str| {
            format!(
                "{ALARM} WHERE (l.standing <> 'normal' OR l.shelved_until_ns IS NOT NULL) AND c.asset_id IN ({these})
                 ORDER BY c.asset_id, c.channel_no, l.id"
            )
        };
        self.rows_of_assets(assets, text).await?.iter().map(alarm_of).collect()
    }

    /// The latest `limit` entries of an alarm's history, the earliest first, and the number of all entries.
    pub async fn alarm_history(
        &self,
        id: &str,
        limit: u32,
    ) -> Result<(Vec<StoredAlarmChange>, u64), StoreError> {
        let count = sqlx::query("SELECT COUNT(*) FROM alarm_changes WHERE alarm_id = $1")
            .bind(id)
            .fetch_one(self.read())
            .await?;
        let count = u64::try_from(count.try_get::<i64, _>(0)?).unwrap_or(0);
        let latest =
            "SELECT * FROM alarm_changes WHERE alarm_id = $1 ORDER BY place DESC, number DESC LIMIT $2";
        let mut rows = sqlx::query(latest).bind(id).bind(i64::from(limit)).fetch_all(self.read()).await?;
        rows.reverse();
        let entries: Result<Vec<_>, StoreError> = rows.iter().map(change_of).collect();
        Ok((entries?, count))
    }

    /// The operator actions on a channel's alarms, in the order in which they take effect, and whether the
    /// channel has any alarm.
    pub async fn alarm_actions(
        &self,
        channel: &ChannelSummary,
    ) -> Result<(Vec<PanelAction>, bool), StoreError> {
        let rows = sqlx::query("SELECT quantity FROM alarms WHERE channel_no = $1 LIMIT 1")
            .bind(channel.channel_no)
            .fetch_all(self.read())
            .await?;
        if rows.is_empty() {
            return Ok((Vec::new(), false));
        }
        let rows = sqlx::query(
            "SELECT l.id, l.quantity, d.action FROM alarm_actions d JOIN alarms l ON l.id = d.alarm_id
             WHERE l.channel_no = $1 ORDER BY d.after_ns, d.number",
        )
        .bind(channel.channel_no)
        .fetch_all(self.read())
        .await?;
        let action = |row: &AnyRow| {
            let id: String = get(row, "id")?;
            Ok(PanelAction {
                quantity: get_json(row, "quantity", &id)?,
                taken: get_json(row, "action", &id)?,
            })
        };
        let actions: Result<Vec<_>, StoreError> = rows.iter().map(action).collect();
        Ok((actions?, true))
    }
}

pub(in crate::store) fn alarm_of(row: &AnyRow) -> Result<StoredAlarm, StoreError> {
    let id: String = get(row, "id")?;
    let rule: Option<String> = get(row, "rule")?;
    Ok(StoredAlarm {
        asset_id: asset_id(get(row, "asset_id")?)?,
        channel: get(row, "channel")?,
        quantity: get_json(row, "quantity", &id)?,
        rule: rule.map(|text| from_json(&text, "rule", &id)).transpose()?,
        alarm: get_json(row, "alarm", &id)?,
        changed_at: from_ns(get(row, "changed_at_ns")?),
        id,
    })
}

pub(in crate::store) fn change_of(row: &AnyRow) -> Result<StoredAlarmChange, StoreError> {
    let id: String = get(row, "alarm_id")?;
    Ok(StoredAlarmChange {
        change: get_json(row, "change", &id)?,
        withdrawn_at: get::<Option<i64>>(row, "withdrawn_at_ns")?.map(from_ns),
    })
}
