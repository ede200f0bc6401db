//! Notifications by webhook, received by a web server in the test.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use flankwatch::estimate::Severity;
use flankwatch::http::ServiceConfig;
use flankwatch::notifications::{NotificationsTable, Notifier};
use flankwatch::store::{Attempt, PendingNotification, Recipient};
use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use crate::alarms::{at_once, loud, watched};
use crate::running::{Service, minute};

const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";

/// Timeout of background work.
pub(crate) const SOON: Duration = Duration::from_secs(60);

/// Configures a recipient of all severities and one of danger only.
fn two_recipients(config: &mut ServiceConfig) {
    let recipient = |name: &str, at_least| Recipient { name: name.to_owned(), at_least };
    config.recipients.list = vec![recipient("all", Severity::Warning), recipient("danger", Severity::Danger)];
}

pub(crate) fn one_recipient(config: &mut ServiceConfig) {
    two_recipients(config);
    config.recipients.list.truncate(1);
}

/// Starts a notifier with the given settings.
fn notifier(service: &Service, table: &str) -> Notifier {
    let table: NotificationsTable = toml::from_str(table).unwrap();
    let settings = table.resolve(|_| Some(SECRET.to_owned())).unwrap();
    service.run(async { Notifier::start(settings, &service.service()) })
}

pub(crate) fn stop(service: &Service, notifier: Notifier) {
    service.run(notifier.stop(Duration::from_secs(20)));
}

/// A request received by a test web server.
struct Received {
    headers: Vec<(String, String)>,
    body: String,
}

impl Received {
    fn header(&self, name: &str) -> &str {
        let found = self.headers.iter().find(|(key, _)| key == name);
        found.map_or("", |(_, value)| value)
    }

    fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap()
    }

    /// Returns the kind, the number among the alarm's notifications, and the severities before and after.
    fn summary(&self) -> Value {
        let body = self.json();
        let data = &body["data"];
        json!([body["type"], data["number"], data["severity_before"], data["severity"]])
    }
}

/// A web server that answers every request with the same status.
struct WebServer {
    port: u16,
    status: Arc<AtomicU16>,
    requests: Receiver<Received>,
}

impl WebServer {
    fn start(status: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let status = Arc::new(AtomicU16::new(status));
        let (sender, requests) = channel();
        let answered = Arc::clone(&status);
        std::thread::spawn(move || {
            for connection in listener.incoming() {
                let answered = answered.load(Ordering::SeqCst);
                if sender.send(take_request(connection.unwrap(), answered)).is_err() {
                    return;
                }
            }
        });
        Self { port, status, requests }
    }

    fn table(&self, name: &str) -> String {
        let port = self.port;
        format!("[[webhook]]\nname = \"{name}\"\nurl = \"http://127.0.0.1:{port}/hook/{name}\"\n")
    }

    #[track_caller]
    fn next(&self) -> Received {
        self.requests.recv_timeout(SOON).unwrap()
    }
}

fn take_request(connection: TcpStream, status: u16) -> Received {
    let mut reader = BufReader::new(connection);
    let mut line = String::new();
    reader.read_line(&mut line).unwrap();
    assert!(line.starts_with("POST /hook/"), "{line}");
    let mut headers = Vec::new();
    loop {
        line.clear();
        reader.read_line(&mut line).unwrap();
        let Some((name, value)) = line.trim().split_once(": ") else { break };
        headers.push((name.to_ascii_lowercase(), value.to_owned()));
    }
    let mut received = Received { headers, body: String::new() };
    let length: u64 = received.header("content-length").parse().unwrap();
    reader.by_ref().take(length).read_to_string(&mut received.body).unwrap();
    let answer = format!("HTTP/1.1 {status} Done\r\ncontent-length: 0\r\nconnection: close\r\n\r\n");
    reader.get_mut().write_all(answer.as_bytes()).unwrap();
    received
}

/// Waits until a recipient satisfies a condition, and returns it.
pub(crate) fn wait_for(service: &Service, name: &str, is_wanted: impl Fn(&Value) -> bool) -> Value {
    let of = |list: &Value| -> Value {
        let mut items = list["items"].as_array().unwrap().iter();
        items.find(|item| item["name"] == name).cloned().unwrap_or_default()
    };
    of(&service.wait_for("/v1/notifications", |list| is_wanted(&of(list))))
}

#[test]
fn notifications_are_ordered_signed_and_filtered_by_severity() {
    let service = Service::start_with(two_recipients);
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    let (all, danger) = (WebServer::start(204), WebServer::start(200));
    let table =
        format!("dashboard_url = \"https://watch.example/\"\n{}{}", all.table("all"), danger.table("danger"));
    let notifier = notifier(&service, &table);
    // Quiet, warning, danger, warning, quiet.
    for (n, factor) in [(0, 1.0), (1, 2.2), (2, 4.0), (3, 2.2), (4, 1.0)] {
        service.upload("pump", &loud(n, factor));
    }
    let received: Vec<Received> = (0..4).map(|_| all.next()).collect();
    let words: Vec<Value> = received.iter().map(Received::summary).collect();
    assert_eq!(
        words,
        [
            json!(["alarm.raised", 1, null, "warning"]),
            json!(["alarm.worsened", 2, "warning", "danger"]),
            json!(["alarm.eased", 3, "danger", "warning"]),
            json!(["alarm.cleared", 4, "warning", null]),
        ]
    );
    let words: Vec<Value> = (0..2).map(|_| danger.next().summary()).collect();
    assert_eq!(
        words,
        [json!(["alarm.worsened", 2, "warning", "danger"]), json!(["alarm.eased", 3, "danger", "warning"])]
    );

    let first = received[0].json();
    let alarm = service.get("/v1/alarms").expect(200).json()["items"][0].clone();
    let data = &first["data"];
    assert_eq!((&data["asset_id"], &data["channel"]), (&json!("pump"), &json!("1")));
    assert_eq!((&data["alarm_id"], &data["quantity"]), (&alarm["id"], &alarm["quantity"]));
    assert_eq!((&data["time"], &data["rule"]["danger"]), (&json!(minute(1)), &json!(2.5)));
    assert!(data["value"].as_f64().unwrap() > 1.5, "{data}");
    let id = alarm["id"].as_str().unwrap();
    assert_eq!(data["url"], format!("https://watch.example/#/alarms?show=all&alarm={id}"));
    assert_eq!(received[0].header("webhook-id"), data["id"].as_str().unwrap());
    assert_eq!(received[0].header("content-type"), "application/json");
    assert_eq!(received[0].header("webhook-signature"), signed(&received[0]));
    let shown = wait_for(&service, "all", |shown| shown["sent"] == 4);
    assert_eq!(
        (&shown["waiting"], &shown["given_up"], &shown["error"]),
        (&json!(0), &json!(0), &Value::Null)
    );
    let metrics = String::from_utf8(service.get("/metrics").expect(200).bytes).unwrap();
    assert!(metrics.contains("flankwatch_notifications_sent{recipient=\"danger\"} 2"), "{metrics}");
    stop(&service, notifier);
}

/// Returns the signature that a receiver expects.
fn signed(received: &Received) -> String {
    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;
    let key = STANDARD.decode(SECRET.trim_start_matches("whsec_")).unwrap();
    let key = ring::hmac::Key::new(ring::hmac::HMAC_SHA256, &key);
    let (id, time) = (received.header("webhook-id"), received.header("webhook-timestamp"));
    let tag = ring::hmac::sign(&key, format!("{id}.{time}.{}", received.body).as_bytes());
    format!("v1,{}", STANDARD.encode(tag))
}

#[test]
fn failed_notifications_survive_a_restart_and_keep_their_id() {
    let mut service = Service::start_with(one_recipient);
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    // Nobody sends yet.
    service.upload("pump", &loud(0, 4.0));
    service.restart();
    let shown = wait_for(&service, "all", |shown| shown["waiting"] == 1);
    assert_eq!((&shown["sent"], &shown["error"]), (&json!(0), &Value::Null));
    let receiver = WebServer::start(503);
    let first = notifier(&service, &receiver.table("all"));
    let refused = receiver.next();
    let shown = wait_for(&service, "all", |shown| !shown["error"].is_null());
    assert_eq!((&shown["waiting"], &shown["oldest_at"]), (&json!(1), &json!(minute(0))));
    assert!(shown["error"].as_str().unwrap().contains("status 503"), "{shown}");
    // It is not sent before the waiting one.
    service.upload("pump", &loud(1, 1.0));
    stop(&service, first);
    service.restart();
    receiver.status.store(200, Ordering::SeqCst);
    service.clock.advance(6);
    let second = notifier(&service, &receiver.table("all"));
    let (repeated, cleared) = (receiver.next(), receiver.next());
    assert_eq!(repeated.body, refused.body);
    assert_eq!(repeated.header("webhook-id"), refused.header("webhook-id"));
    assert_eq!(cleared.summary(), json!(["alarm.cleared", 2, "danger", null]));
    let shown = wait_for(&service, "all", |shown| shown["sent"] == 2);
    assert_eq!((&shown["waiting"], &shown["error"]), (&json!(0), &Value::Null));
    stop(&service, second);
}

#[test]
fn failed_notifications_are_given_up_after_a_day_and_reported() {
    let service = Service::start_with(one_recipient);
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    let receiver = WebServer::start(500);
    let notifier = notifier(&service, &receiver.table("all"));
    service.upload("pump", &loud(0, 4.0));
    receiver.next();
    wait_for(&service, "all", |shown| !shown["error"].is_null());
    service.clock.advance(25 * 3600);
    receiver.next();
    let shown = wait_for(&service, "all", |shown| shown["given_up"] == 1);
    assert_eq!((&shown["waiting"], &shown["sent"]), (&json!(0), &json!(0)));
    assert!(shown["error"].as_str().unwrap().contains("500"), "{shown}");
    let metrics = String::from_utf8(service.get("/metrics").expect(200).bytes).unwrap();
    assert!(metrics.contains("flankwatch_notifications_given_up{recipient=\"all\"} 1"), "{metrics}");
    stop(&service, notifier);
}

#[test]
fn a_shelved_alarm_is_notified_after_shelving_and_old_records_are_not() {
    let service = Service::start_with(|config| {
        one_recipient(config);
        config.recipients.newer_than = SignedDuration::from_mins(30);
    });
    let receiver = WebServer::start(200);
    let notifier = notifier(&service, &receiver.table("all"));
    service.clock.advance(3600);
    service.post_json("/v1/assets", &watched("old", &at_once())).expect(201);
    service.upload("old", &loud(0, 4.0));
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    service.upload("pump", &loud(55, 2.2));
    assert_eq!(receiver.next().json()["data"]["asset_id"], "pump");
    let alarm = service.get("/v1/alarms?asset=pump").expect(200).json()["items"][0].clone();
    let act = |action: &str, body: &Value| {
        let id = alarm["id"].as_str().unwrap();
        service.post_json(&format!("/v1/alarms/{id}/{action}"), body).expect(200);
    };
    act("shelve", &json!({ "by": "Ada", "until": minute(120) }));
    service.upload("pump", &loud(56, 4.0));
    act("comment", &json!({ "by": "Ada", "comment": "worse" }));
    // The last notification, so none was sent while the alarm was shelved.
    act("unshelve", &json!({ "by": "Ada" }));
    assert_eq!(receiver.next().summary(), json!(["alarm.worsened", 2, "warning", "danger"]));
    act("acknowledge", &json!({ "by": "Ada" }));
    // An asset whose rule is taken away has no alarm any more.
    let mut without = watched("pump", &at_once());
    without["alarms"] = json!([]);
    service.put_json("/v1/assets/pump", &without).expect(200);
    assert_eq!(receiver.next().summary(), json!(["alarm.cleared", 3, "danger", null]));
    stop(&service, notifier);
}

#[test]
fn a_notification_is_leased_by_one_sender_at_a_time() {
    let service = Service::start_with(one_recipient);
    for n in 0..6 {
        let asset = format!("pump-{n}");
        service.post_json("/v1/assets", &watched(&asset, &at_once())).expect(201);
        service.upload(&asset, &loud(0, 4.0));
    }
    let store = service.service().store.clone();
    let (lease, now) = (SignedDuration::from_secs(60), minute(0));
    // Senders are tasks here and processes in a cluster.
    let taken: Vec<PendingNotification> = service.run(async {
        let ask = |_| {
            let store = store.clone();
            tokio::spawn(async move { store.next_notification("all", lease, now).await.unwrap() })
        };
        let senders: Vec<_> = (0..12).map(ask).collect();
        let mut taken = Vec::new();
        for sender in senders {
            taken.extend(sender.await.unwrap());
        }
        taken
    });
    let ids: BTreeSet<&str> = taken.iter().map(|pending| pending.notification.id.as_str()).collect();
    assert_eq!((taken.len(), ids.len()), (6, 6));
    // A sender whose lease has expired can no longer record an outcome.
    let first = &taken[0];
    let again = service.run(async {
        let failed = Attempt::Failed { error: "away".to_owned(), again_at: Timestamp::UNIX_EPOCH };
        store.end_attempt(first, &failed, now).await.unwrap();
        let again = store.next_notification("all", lease, now).await.unwrap().unwrap();
        let late = Attempt::GivenUp { error: "late".to_owned() };
        store.end_attempt(first, &late, now).await.unwrap();
        again
    });
    assert_eq!((&again.notification, again.attempts), (&first.notification, 2));
    let shown = wait_for(&service, "all", |_| true);
    assert_eq!(
        (&shown["waiting"], &shown["given_up"], &shown["error"]),
        (&json!(6), &json!(0), &json!("away"))
    );
}
