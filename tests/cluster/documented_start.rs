//! The section "From nothing to two nodes and two workers" of docs/cluster.md, followed as it stands.

use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use super::postgres::PostgresServer;
use super::processes::{NatsServer, S3Server, free_port};

/// Number of records that the section sends.
const RECORDS: usize = 30;

/// Seconds until everything must be done.
const PATIENCE_S: &str = "240";

/// Ports of the processes in the section.
const DOCUMENTED_PORTS: [&str; 4] = ["8600", "8601", "8602", "8603"];

/// Returns the blocks of a language in the section.
fn blocks<'a>(section: &'a str, language: &str) -> Vec<&'a str> {
    let begin = format!("```{language}\n");
    section.split(begin.as_str()).skip(1).map(|rest| rest.split("```").next().unwrap()).collect()
}

#[test]
#[ignore = "needs PostgreSQL, nats-server, moto_server and the AWS CLI"]
fn the_documented_cluster_starts_and_stores_records() {
    let doc = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/cluster.md");
    let text = std::fs::read_to_string(doc).unwrap();
    let heading = "## From nothing to two nodes and two workers\n";
    let section = text.split(heading).nth(1).expect(heading).split("\n## ").next().unwrap();

    let folder = tempfile::tempdir().unwrap();
    let postgres = PostgresServer::start();
    let (nats, objects) = (NatsServer::start(folder.path()), S3Server::start());
    let ports: Vec<String> = DOCUMENTED_PORTS.iter().map(|_| free_port().to_string()).collect();
    let here = |text: &str| {
        let text = DOCUMENTED_PORTS
            .iter()
            .enumerate()
            .fold(text.to_owned(), |text, (n, documented)| text.replace(documented, &format!("<port {n}>")));
        let text =
            ports.iter().enumerate().fold(text, |text, (n, port)| text.replace(&format!("<port {n}>"), port));
        text.replace("postgres://postgres@127.0.0.1:5432/postgres", &postgres.url())
            .replace("127.0.0.1:5432", &postgres.address())
            .replace("nats://127.0.0.1:4222", &nats.url())
            .replace("127.0.0.1:9000", &objects.address().to_string())
    };

    let [settings] = blocks(section, "toml")[..] else { panic!("one settings file") };
    let commands = blocks(section, "sh");
    let (last, commands) = commands.split_last().unwrap();
    let script = format!(
        "trap 'kill $(jobs -p)' EXIT\n{}\nread_back() {{\n{last}\n}}\n\
         until [ \"$(read_back | grep -o segment_id | wc -l)\" = {RECORDS} ]; do sleep 0.5; done",
        commands.concat(),
    );
    let script = here(&script);
    std::fs::write(folder.path().join("cluster.toml"), here(settings)).unwrap();

    let programs = folder.path().join("programs");
    std::fs::create_dir(&programs).unwrap();
    symlink(env!("CARGO_BIN_EXE_flankwatch"), programs.join("flankwatch")).unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let output = Command::new("timeout")
        .args([PATIENCE_S, "bash", "-euo", "pipefail", "-c", &script])
        .current_dir(folder.path())
        .env("PATH", path)
        .envs([("AWS_ACCESS_KEY_ID", "access-key"), ("AWS_SECRET_ACCESS_KEY", "access-secret")])
        .env("AWS_DEFAULT_REGION", "us-east-1")
        .output()
        .unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{}\n{script}\n{out}\n{err}", output.status);
    let workers = out.lines().find_map(|line| line.strip_prefix("workers ")).map(str::trim);
    assert_eq!(workers, Some("2"), "{out}");
}
