//! Records over MQTT: each message becomes one record or is rejected with a reason.

use std::collections::BTreeSet;

use flankwatch::mqtt::{MqttCredentials, MqttFeed, MqttTable};
use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::signal::Record;
use serde_json::{Value, json};

use crate::broker::{Broker, LONGEST, Listener, Sender, unique};
use crate::running::{Service, plain_asset, record};
use flankwatch_test_support::needed;

/// Starts a feed from a broker; `more` has additional lines of the settings.
pub(crate) fn feed(service: &Service, port: u16, root: &str, more: &str) -> MqttFeed {
    // A short session expiry.
    let text =
        format!("url = \"mqtt://127.0.0.1:{port}\"\nroot = \"{root}\"\nsession_expiry_s = 120\n{more}");
    // A unique client ID, unless the settings have one.
    let own = if more.contains("client_id") {
        String::new()
    } else {
        format!("client_id = \"{}\"", unique("service"))
    };
    start(service, &format!("{text}\n{own}"))
}

fn start(service: &Service, table: &str) -> MqttFeed {
    let table: MqttTable = toml::from_str(table).unwrap();
    let settings = table.resolve(MqttCredentials::default(), 1 << 20).unwrap();
    let feed = service.run(async { MqttFeed::start(settings, service.service()) }).unwrap();
    // The latest feed; earlier ones may have been stopped, and the service may be full.
    let began = std::time::Instant::now();
    loop {
        let ready = service.get("/readyz").json();
        if ready["feeds"].as_array().unwrap().last().unwrap()["is_connected"] == true {
            return feed;
        }
        assert!(began.elapsed() < LONGEST, "{ready}");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}

/// Waits until the service has `count` records, and checks that it has no more.
#[track_caller]
pub(crate) fn wait_for_records(service: &Service, count: u32) {
    let began = std::time::Instant::now();
    let mut found = 0.0;
    while found < f64::from(count) {
        assert!(began.elapsed() < LONGEST, "{found} of {count} records");
        std::thread::sleep(std::time::Duration::from_millis(20));
        found = metric(service, "flankwatch_segments ");
    }
    assert_eq!(found, f64::from(count));
}

fn protobuf(record: &Record) -> Vec<u8> {
    encode_block(record, BlockEncoding::Protobuf)
}

pub(crate) fn topic(root: &str, asset: &str, point: &str) -> String {
    format!("{root}/{asset}/{point}/waveform")
}

pub(crate) fn metric(service: &Service, name: &str) -> f64 {
    let text = String::from_utf8(service.get("/metrics").expect(200).bytes).unwrap();
    let line = text.lines().find(|line| line.starts_with(name));
    let line = line.unwrap_or_else(|| panic!("no {name} in {text}"));
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

fn outcome(service: &Service, outcome: &str) -> f64 {
    metric(service, &format!("flankwatch_feed_messages_total{{feed=\"mqtt\",outcome=\"{outcome}\"}}"))
}

/// Waits until `count` messages have an outcome.
#[track_caller]
fn wait_for_outcome(service: &Service, what: &str, count: f64) {
    let began = std::time::Instant::now();
    while outcome(service, what) < count {
        assert!(began.elapsed() < LONGEST, "{} of {count} {what}", outcome(service, what));
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}

fn times(service: &Service, asset: &str) -> BTreeSet<String> {
    let segments = service.get(&format!("/v1/assets/{asset}/segments?limit=1000")).expect(200).json();
    let items = segments["items"].as_array().unwrap();
    let times: BTreeSet<String> =
        items.iter().map(|item| item["start_time"].as_str().unwrap().to_owned()).collect();
    assert_eq!(times.len(), items.len(), "a record is there twice");
    times
}

#[test]
#[ignore = "needs mosquitto"]
fn every_message_becomes_one_record() {
    let broker = Broker::start();
    let port = broker.port;
    let service = Service::start();
    service.plain_asset("pump");
    let root = unique("once");
    let feed = feed(&service, port, &root, "");
    let mut sender = Sender::connect(port);
    for n in 0..20 {
        let record = record("named otherwise", n);
        let (encoding, media_type) = match n % 2 {
            0 => (BlockEncoding::Protobuf, "application/x-protobuf"),
            _ => (BlockEncoding::Json, "application/json"),
        };
        let block = encode_block(&record, encoding);
        let content_type = (n % 4 < 2).then_some(media_type);
        sender.send_as(&topic(&root, "pump", "input"), &block, content_type);
        if n % 5 == 0 {
            // A device that sends again as it has no acknowledgement.
            sender.send_as(&topic(&root, "pump", "input"), &block, content_type);
        }
    }
    wait_for_outcome(&service, "accepted", 24.0);
    assert_eq!(times(&service, "pump").len(), 20);
    let segments = service.get("/v1/assets/pump/segments?limit=1").expect(200).json();
    assert_eq!(segments["items"][0]["channel"], "input", "the topic's point goes before the message's own");
    // The same values as for an upload of the same record.
    service.plain_asset("uploaded");
    let uploaded = service.upload("uploaded", &record("input", 19));
    let ours = service.get("/v1/assets/pump/indicators").expect(200).json();
    let last = ours["items"].as_array().unwrap().last().unwrap().clone();
    assert_eq!(last["rms"], uploaded["indicators"]["rms"], "{last}");
    assert_eq!(metric(&service, "flankwatch_records_total{outcome=\"repeated\"}"), 4.0);
    assert_eq!((outcome(&service, "received"), outcome(&service, "refused")), (24.0, 0.0));
    assert_eq!(metric(&service, "flankwatch_feed_connected{feed=\"mqtt\"}"), 1.0);
    let health = service.get("/readyz").expect(200).json();
    let expected = json!([{ "name": "mqtt", "is_connected": true, "held": 0 }]);
    assert_eq!(health["feeds"], expected);
    service.run(feed.stop(LONGEST));
    let health = service.get("/readyz").expect(200).json();
    assert_eq!((&health["status"], &health["feeds"][0]["trouble"]), (&"ok".into(), &"stopped".into()));
}

/// An invalid message, with the expected status and words of its rejection.
struct Unusable {
    asset: &'static str,
    point: &'static str,
    payload: Vec<u8>,
    content_type: Option<&'static str>,
    status: u16,
    words: &'static str,
}

impl Unusable {
    fn new(
        asset: &'static str,
        point: &'static str,
        payload: Vec<u8>,
        status: u16,
        words: &'static str,
    ) -> Self {
        Self { asset, point, payload, content_type: None, status, words }
    }
}

#[test]
#[ignore = "needs mosquitto"]
fn invalid_messages_are_rejected_with_the_reason() {
    let broker = Broker::start();
    let port = broker.port;
    let service = Service::start();
    service.plain_asset("pump");
    let root = unique("refused");
    let listener = Listener::connect(port, &format!("{root}/+/+/rejected"));
    let feed = feed(&service, port, &root, "message_bytes = 100000");
    let good = protobuf(&record("1", 1));
    let mut no_time = Record::new("1", jiff::Timestamp::UNIX_EPOCH, 4000.0, "g", vec![1.0; 100]).unwrap();
    let no_time_protobuf = protobuf(&no_time);
    no_time = no_time.with_channel("2");
    let mut no_time_json: Value =
        serde_json::from_slice(&encode_block(&no_time, BlockEncoding::Json)).unwrap();
    no_time_json.as_object_mut().unwrap().remove("start_time");
    let text = b"{\"samples\": [1]}".to_vec();
    let (timeless, in_json) = ("start_time is missing", no_time_json.to_string().into_bytes());
    let undecodable = "not a WaveformBlock in protobuf";
    let cases = [
        Unusable::new("nobody", "1", good.clone(), 404, "nobody"),
        Unusable::new("Pump", "1", good.clone(), 400, "a-z"),
        Unusable::new("pump", "empty", Vec::new(), 422, "the message is empty"),
        Unusable::new("pump", "noise", vec![0xff; 50], 422, undecodable),
        Unusable::new("pump", "cut", good[..good.len() / 2].to_vec(), 422, undecodable),
        Unusable::new("pump", "text", text, 422, "missing field `sample_rate_hz`"),
        Unusable {
            content_type: Some("audio/wav"),
            ..Unusable::new("pump", "wav", good.clone(), 415, "application/x-protobuf or application/json")
        },
        Unusable::new("pump", "large", vec![0; 100_001], 413, "100001"),
        Unusable::new("pump", "timeless", no_time_protobuf, 422, timeless),
        Unusable::new("pump", "timeless-json", in_json, 422, timeless),
    ];
    let mut sender = Sender::connect(port);
    for case in &cases {
        sender.send_as(&topic(&root, case.asset, case.point), &case.payload, case.content_type);
    }
    sender.send(&topic(&root, "pump", "good"), &good);
    let rejections = listener.wait_for(cases.len());
    assert_eq!(rejections.len(), cases.len());
    for case in &cases {
        let address = format!("{root}/{}/{}", case.asset, case.point);
        let found = rejections.iter().find(|(topic, _)| *topic == format!("{address}/rejected"));
        let (_, problem) = found.unwrap_or_else(|| panic!("nothing of {address} in {rejections:?}"));
        assert_eq!(problem["status"], case.status, "{problem}");
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains(case.words), "{:?} in {problem}", case.words);
        assert_eq!(problem["topic"], format!("{address}/waveform"));
        assert_eq!(problem["payload_bytes"], case.payload.len());
        assert_eq!(problem["payload_sha256"].as_str().map(str::len), Some(64));
    }
    wait_for_outcome(&service, "accepted", 1.0);
    assert_eq!(outcome(&service, "refused"), 10.0);
    // Rejected messages are acknowledged: none is sent again in the session.
    service.run(feed.stop(LONGEST));
    assert_eq!(times(&service, "pump").len(), 1);
}

#[test]
#[ignore = "needs mosquitto"]
fn a_misaddressed_publisher_does_not_block_others() {
    let broker = Broker::start();
    let service = Service::start();
    service.plain_asset("wheel");
    let mut pinion = plain_asset("pinion");
    pinion["gear"] = json!({ "teeth": [17, 50], "shaft_speed_hz": 5.0, "shaft_ratio": [31, 62] });
    pinion["sensor"]["of"] = json!("wheel");
    service.post_json("/v1/assets", &pinion).expect(201);
    let listener = Listener::connect(broker.port, "flankwatch/+/+/rejected");
    let feed = feed(&service, broker.port, "flankwatch", "");
    let mut sender = Sender::connect(broker.port);
    for n in 0..40 {
        sender.send(&topic("flankwatch", "pinion", "1"), &protobuf(&record("1", n)));
    }
    for n in 0..20 {
        sender.send(&topic("flankwatch", "wheel", "1"), &protobuf(&record("1", n)));
    }
    wait_for_outcome(&service, "accepted", 20.0);
    assert_eq!(times(&service, "wheel").len(), 20);
    for (topic, problem) in listener.wait_for(40) {
        assert_eq!((topic.as_str(), &problem["status"]), ("flankwatch/pinion/1/rejected", &json!(409)));
        assert!(problem["detail"].as_str().unwrap().contains("wheel"), "{problem}");
    }
    assert_eq!(outcome(&service, "refused"), 40.0);
    service.run(feed.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn messages_sent_while_the_service_is_down_are_not_lost() {
    let broker = Broker::start();
    let port = broker.port;
    let service = Service::start();
    service.plain_asset("pump");
    let (root, session) = (unique("away"), format!("client_id = \"{}\"", unique("service")));
    let first = feed(&service, port, &root, &session);
    service.run(first.stop(LONGEST));
    let mut sender = Sender::connect(port);
    for n in 0..10 {
        sender.send(&topic(&root, "pump", "1"), &protobuf(&record("1", n)));
    }
    assert_eq!(times(&service, "pump").len(), 0);
    let second = feed(&service, port, &root, &session);
    wait_for_records(&service, 10);
    service.run(second.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn a_full_service_leaves_messages_at_the_broker() {
    let broker = Broker::start();
    let service = Service::start();
    service.plain_asset("pump");
    let parts = service.service();
    let tickets: Vec<_> = std::iter::from_fn(|| parts.workers.admit().ok()).collect();
    assert!(!tickets.is_empty());
    let feed = feed(&service, broker.port, "flankwatch", "in_flight = 4");
    let mut sender = Sender::connect(broker.port);
    for n in 0..40 {
        sender.send(&topic("flankwatch", "pump", "1"), &protobuf(&record("1", n)));
    }
    // The queue is full, and the feed reports it.
    let health = service.get("/readyz").json();
    let began = std::time::Instant::now();
    let mut held = health;
    while held["feeds"][0]["held"] != 4 {
        assert!(began.elapsed() < LONGEST, "{held}");
        std::thread::sleep(std::time::Duration::from_millis(20));
        held = service.get("/readyz").json();
    }
    assert!(held["feeds"][0]["trouble"].as_str().unwrap().contains("queue"), "{held}");
    assert_eq!(metric(&service, "flankwatch_feed_messages_held{feed=\"mqtt\"}"), 4.0);
    assert_eq!((outcome(&service, "received"), outcome(&service, "accepted")), (4.0, 0.0));
    drop(tickets);
    wait_for_outcome(&service, "accepted", 40.0);
    assert_eq!(times(&service, "pump").len(), 40);
    assert_eq!(outcome(&service, "received"), 40.0, "none was sent twice");
    assert_eq!(service.get("/readyz").expect(200).json()["feeds"][0]["held"], 0);
    service.run(feed.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn dropped_messages_are_received_again() {
    let broker = Broker::start();
    let service = Service::start();
    service.plain_asset("pump");
    let settings = "in_flight = 4\nkeep_alive_s = 5\nclient_id = \"kept\"";
    let first = feed(&service, broker.port, "flankwatch", settings);
    service.run(first.stop(LONGEST));
    let mut sender = Sender::connect(broker.port);
    for n in 0..40 {
        sender.send(&topic("flankwatch", "pump", "1"), &protobuf(&record("1", n)));
    }
    let parts = service.service();
    let tickets: Vec<_> = std::iter::from_fn(|| parts.workers.admit().ok()).collect();
    let second = feed(&service, broker.port, "flankwatch", settings);
    // Longer than the keep-alive: the session's messages may arrive all at once, and the connection must
    // survive.
    std::thread::sleep(std::time::Duration::from_secs(10));
    let feeds = service.get("/readyz").json()["feeds"].clone();
    assert_eq!((&feeds[1]["is_connected"], &feeds[1]["held"]), (&true.into(), &4.into()), "{feeds}");
    drop(tickets);
    wait_for_records(&service, 40);
    service.run(second.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn nodes_that_share_a_subscription_share_the_messages() {
    let broker = Broker::start();
    let port = broker.port;
    let (one, other) = (Service::start(), Service::start());
    let root = unique("shared");
    let settings = |name: &str| format!("share = \"nodes\"\nclient_id = \"{}\"", unique(name));
    let feeds = [&one, &other].map(|service| {
        service.plain_asset("pump");
        feed(service, port, &root, &settings("node"))
    });
    let mut sender = Sender::connect(port);
    for n in 0..40 {
        sender.send(&topic(&root, "pump", "1"), &protobuf(&record("1", n)));
    }
    let began = std::time::Instant::now();
    while outcome(&one, "accepted") + outcome(&other, "accepted") < 40.0 {
        assert!(began.elapsed() < LONGEST);
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let (first, second) = (times(&one, "pump"), times(&other, "pump"));
    assert!(!first.is_empty() && !second.is_empty(), "{} and {}", first.len(), second.len());
    assert!(first.is_disjoint(&second));
    assert_eq!(first.len() + second.len(), 40);
    for (service, feed) in [&one, &other].into_iter().zip(feeds) {
        service.run(feed.stop(LONGEST));
    }
}

#[test]
#[ignore = "needs mosquitto and its clients"]
fn client_certificates_and_passwords_are_sent_over_tls() {
    let folder = tempfile::tempdir().unwrap();
    let made = ["server", "client"].map(|who| {
        let folder = folder.path().join(who);
        std::fs::create_dir(&folder).unwrap();
        crate::certificate::certificate(&folder)
    });
    let [server, client] = made;
    let passwords = folder.path().join("passwords");
    std::fs::write(&passwords, "").unwrap();
    let mut maker = std::process::Command::new("mosquitto_passwd");
    let added = maker.arg("-b").arg(&passwords).args(["flankwatch", "correct horse"]).output().ok();
    let added = added.filter(|output| output.status.success());
    needed(added, "mosquitto_passwd (apt install mosquitto)");
    let settings = format!(
        "allow_anonymous false\npassword_file {}\ncafile {}\ncertfile {}\nkeyfile {}\nrequire_certificate true\n",
        passwords.display(),
        client.certificate.display(),
        server.certificate.display(),
        server.key.display()
    );
    let broker = Broker::start_with(|_| settings);
    let secret = folder.path().join("secret");
    std::fs::write(&secret, "wrong\n").unwrap();
    let table = |authority: &std::path::Path, shown: &str| {
        format!(
            "url = \"mqtts://127.0.0.1:{}\"\nusername = \"flankwatch\"\npassword_file = \"{}\"\nca_file = \"{}\"\n{shown}",
            broker.port,
            secret.display(),
            authority.display()
        )
    };
    let shown =
        format!("certificate = \"{}\"\nkey = \"{}\"", client.certificate.display(), client.key.display());
    let trouble = |table: &str, words: &[&str]| {
        let service = Service::start();
        let table: MqttTable = toml::from_str(table).unwrap();
        let settings = table.resolve(MqttCredentials::default(), 1 << 20).unwrap();
        let feed = service.run(async { MqttFeed::start(settings, service.service()) }).unwrap();
        let ready = service.wait_for("/readyz", |ready| {
            let trouble = ready["feeds"][0]["trouble"].as_str().unwrap_or_default();
            words.iter().any(|word| trouble.contains(word))
        });
        assert_eq!(ready["feeds"][0]["is_connected"], false);
        service.run(feed.stop(LONGEST));
    };
    trouble(&table(&server.certificate, &shown), &["NotAuthorized", "BadUserNamePassword"]);
    trouble(&table(&client.certificate, &shown), &["certificate"]);
    trouble(&table(&server.certificate, ""), &["ertificate", "aborted", "closed", "reset"]);
    // The file is read again for each connection.
    let service = Service::start();
    service.plain_asset("pump");
    let resolved: MqttTable = toml::from_str(&table(&server.certificate, &shown)).unwrap();
    let settings = resolved.resolve(MqttCredentials::default(), 1 << 20).unwrap();
    let feed = service.run(async { MqttFeed::start(settings, service.service()) }).unwrap();
    service.wait_for("/readyz", |ready| ready["feeds"][0]["trouble"] != "not connected yet");
    std::fs::write(&secret, "correct horse\n").unwrap();
    service.wait_for("/readyz", |ready| ready["feeds"][0]["is_connected"] == true);
    let mut publisher = std::process::Command::new("mosquitto_pub");
    let message = folder.path().join("message");
    std::fs::write(&message, protobuf(&record("1", 1))).unwrap();
    publisher
        .args(["-h", "127.0.0.1", "-p", &broker.port.to_string(), "-V", "5", "-q", "1"])
        .args(["-u", "flankwatch", "-P", "correct horse", "-t", "flankwatch/pump/1/waveform"])
        .arg("--cafile")
        .arg(&server.certificate)
        .arg("--cert")
        .arg(&client.certificate)
        .arg("--key")
        .arg(&client.key)
        .arg("-f")
        .arg(&message);
    let sent = needed(publisher.output().ok(), "mosquitto_pub (apt install mosquitto-clients)");
    assert!(sent.status.success(), "{}", String::from_utf8_lossy(&sent.stderr));
    wait_for_records(&service, 1);
    service.run(feed.stop(LONGEST));
}
