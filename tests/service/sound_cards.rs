//! `flankwatch stream --alsa`, on devices that ALSA makes of files.

use crate::command::flankwatch;

#[cfg(not(all(feature = "alsa", target_os = "linux")))]
#[test]
fn a_program_without_alsa_says_so() {
    let refused = flankwatch(&["stream", "--asset", "pump", "--alsa", "hw:1", "--rate", "48000"]);
    refused.expect_failure(&["--alsa is hw:1", "built without"]);
}

#[test]
fn a_sound_card_needs_a_rate_and_has_no_start_time() {
    let device = ["stream", "--asset", "pump", "--alsa", "hw:1"];
    flankwatch(&device).expect_failure(&["--rate"]);
    for more in [&["--start-time", "2026-01-01T00:00:00Z"][..], &["--follow"], &["samples.wav"]] {
        let words = [&device[..], &["--rate", "48000"], more].concat();
        flankwatch(&words).expect_failure(&["--alsa", "cannot be used with"]);
    }
    flankwatch(&["stream", "--asset", "pump", "--rate", "48000"]).expect_failure(&["--sample", "--alsa"]);
}

#[cfg(all(feature = "alsa", target_os = "linux"))]
mod devices {
    use std::path::Path;
    use std::process::Command;

    use serde_json::json;

    use crate::running::{Service, plain_asset};

    const RATE_HZ: usize = 8000;

    /// Starts a service with an asset all of whose samples become records of a second.
    fn service() -> Service {
        let service = Service::start();
        let mut asset = plain_asset("pump");
        asset["stream"] = json!({ "record_s": 1, "interval_s": 1 });
        service.post_json("/v1/assets", &asset).expect(201);
        service
    }

    /// Streams a device `test` whose samples are those of a file, and any others without end.
    fn streaming(service: &Service, folder: &Path, more: &[&str]) -> Command {
        let samples = folder.join("samples.raw");
        let config = folder.join("alsa.conf");
        let device = format!(
            "pcm.test {{ type file slave.pcm {{ type null }} file /dev/null infile {samples:?} format raw }}"
        );
        std::fs::write(&config, device).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_flankwatch"));
        command.args(["stream", "--asset", "pump", "--url", &service.url(""), "--rate", "8000"]);
        command.args(more).env("ALSA_CONFIG_PATH", config);
        command
    }

    #[test]
    fn the_samples_of_a_sound_card_are_stored() {
        let service = service();
        let folder = tempfile::tempdir().unwrap();
        let frames = 3 * RATE_HZ;
        let value = |k: usize| (k * 7919 % 60_013) as i32 - 30_000;
        let floats: Vec<u8> = (0..2 * frames).flat_map(|k| (value(k) as f32 / 7.0).to_le_bytes()).collect();
        let integers: Vec<u8> = (0..2 * frames).flat_map(|k| (value(k) as i16).to_le_bytes()).collect();
        for (name, samples, more) in [("float", floats, &[][..]), ("integer", integers, &["--sample", "i16"])]
        {
            std::fs::write(folder.path().join("samples.raw"), &samples).unwrap();
            let channels = format!("{name}-a,{name}-b");
            let words = ["--alsa", "test", "--channels", "2", "--scale", "0.5", "--unit", "m/s2"];
            let before = jiff::Timestamp::now();
            let names = ["--name", name, "--channel-names", &channels];
            // The device measures faster than the service stores.
            let spool = folder.path().join(name);
            let spooled = ["--spool", spool.to_str().unwrap()];
            let words = [&words[..], &names, &spooled, more].concat();
            let mut sender = streaming(&service, folder.path(), &words).spawn().unwrap();
            let path = format!("/v1/assets/pump/stream?name={name}");
            let began = std::time::Instant::now();
            while service.get(&path).json()["records"].as_u64().unwrap_or(0) < 3 {
                assert!(sender.try_wait().unwrap().is_none(), "the command ended");
                assert!(began.elapsed() < std::time::Duration::from_secs(100), "the samples are not stored");
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
            sender.kill().unwrap();
            sender.wait().unwrap();
            let status = service.get(&path).expect(200).json();
            assert_eq!((&status["gaps"], &status["channels"]), (&json!(0), &json!(2)));
            let path = format!("/v1/assets/pump/segments?channel={name}-a&limit=1000");
            let page = service.get(&path).expect(200).json();
            let mut records = page["items"].as_array().unwrap().clone();
            records.sort_by_key(|record| record["start_time"].as_str().unwrap().to_owned());
            let mut stored = Vec::new();
            for record in &records[..3] {
                let raw = format!("/v1/segments/{}/raw", record["id"].as_str().unwrap());
                stored.extend_from_slice(&service.get(&raw).expect(200).bytes);
                assert_eq!(record["unit"], "m/s2");
            }
            assert!(stored == samples, "{} of {} bytes", stored.len(), samples.len());
            // The time of the first sample is that of the clock.
            let time: jiff::Timestamp = records[0]["start_time"].as_str().unwrap().parse().unwrap();
            let age_s = time.duration_since(before).as_secs_f64();
            assert!((-2.0..60.0).contains(&age_s), "{age_s}");
        }
    }

    #[test]
    fn errors_about_a_sound_card_name_it() {
        let service = service();
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("samples.raw"), [0; 4000]).unwrap();
        let fails = |more: &[&str], words: &[&str]| {
            let output = streaming(&service, folder.path(), more).output().unwrap();
            let error = String::from_utf8(output.stderr).unwrap();
            assert!(!output.status.success() && words.iter().all(|word| error.contains(word)), "{error}");
        };
        fails(&["--alsa", "hw:77"], &["--alsa hw:77: failed to open the device"]);
        fails(&["--alsa", "test", "--sample", "i8"], &["i8", "f32 or i16"]);
        fails(&["--alsa", "test", "--channels", "0"], &["--channels is 0", "from 1"]);
    }
}
