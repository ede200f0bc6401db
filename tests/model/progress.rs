//! Progress on a terminal while a command reads recordings.

use std::process::Command;

use crate::command::flankwatch;

/// Runs the program in a terminal, that of `script`, and returns all it prints there.
fn in_terminal(words: &[&str]) -> String {
    let command = [&[env!("CARGO_BIN_EXE_flankwatch")], words].concat().join(" ");
    let output = Command::new("script").args(["-qec", &command, "/dev/null"]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn reading_files_shows_the_time_left_on_a_terminal_only() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let spec = hound::WavSpec {
        channels: 1,
        sample_rate: 8000,
        bits_per_sample: 16,
        sample_format: hound::SampleFormat::Int,
    };
    for name in ["a.wav", "b.wav", "c.wav"] {
        let mut writer = hound::WavWriter::create(folder.path().join(name), spec).unwrap();
        (0..8000).for_each(|k| writer.write_sample((k * 37 % 201) as i16).unwrap());
        writer.finalize().unwrap();
    }
    let (recordings, out) = (folder.path().to_str().unwrap(), elsewhere.path().join("out.mcap"));
    let convert = ["convert", "--unit", "g", "--force", recordings, out.to_str().unwrap()];
    for words in [&["analyze", recordings][..], &convert] {
        let shown = in_terminal(words);
        for expected in ["file 1 of 3", "file 3 of 3", " left, ", "/47.00 KiB"] {
            assert!(shown.contains(expected), "{expected:?} in {shown:?}");
        }
        let printed = flankwatch(words).expect_success().err();
        assert!(!printed.contains(" left"), "{printed}");
    }
}
