//! Writes of SQLite that fail: nothing acknowledged is lost, and what is stored can be read.

use std::path::Path;
use std::process::Command;

use flankwatch::recording::{BlockEncoding, encode_block};
use serde_json::Value;

use crate::program::Program;
use crate::running::{plain_asset, record};

/// Bytes by which the database or its log may grow before a write fails.
const ROOM: u64 = 200 << 10;

fn size(folder: &Path, name: &str) -> u64 {
    std::fs::metadata(folder.join(name)).map_or(0, |data| data.len())
}

#[test]
fn a_failing_write_of_the_database_loses_nothing_acknowledged() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("data");
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    program.kill();
    let largest = size(&folder, "flankwatch.db").max(size(&folder, "flankwatch.db-wal"));
    let program = Program::start_with_file_size(&folder, largest + ROOM);
    let (mut stored, mut refused) = (Vec::new(), 0);
    for n in 0..500 {
        let block = encode_block(&record("1", n), BlockEncoding::Protobuf);
        let headers = [("content-type", "application/x-protobuf")];
        let mut answer = program.send("POST", "/v1/assets/pump/segments", &headers, &block);
        let status = answer.status().as_u16();
        let body: Value = serde_json::from_str(&answer.body_mut().read_to_string().unwrap()).unwrap();
        if status == 201 {
            stored.push(body["id"].as_str().unwrap().to_owned());
            continue;
        }
        assert!([500, 503, 507].contains(&status), "{status}: {body}");
        refused += 1;
        if refused == 10 {
            break;
        }
    }
    assert!(refused == 10 && !stored.is_empty(), "{} stored, {refused} refused", stored.len());
    let is_all_there = |program: &Program| {
        let found = program.segments("pump");
        for id in &stored {
            assert_eq!(found.get(id), Some(&1), "record {id} was acknowledged");
        }
        found.len()
    };
    assert_eq!(is_all_there(&program), stored.len());
    program.kill();

    // The cause is gone.
    let program = Program::start(&folder);
    assert_eq!(is_all_there(&program), stored.len());
    for n in 500..510 {
        program.upload("pump", n).unwrap();
    }
    assert_eq!(is_all_there(&program), stored.len() + 10);
    program.kill();
    // The next start looks after what the refused records left.
    let program = Program::start(&folder);
    let verify = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_flankwatch"));
        command.args(["verify", "--data-dir"]).arg(&folder).output().unwrap()
    };
    let mut output = verify();
    for _ in 0..10 {
        if output.status.success() {
            break;
        }
        output = verify();
    }
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    program.kill();
}
