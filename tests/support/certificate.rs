//! Certificates for tests.

use std::path::Path;
use std::process::Command;

use flankwatch::http::TlsFiles;
use flankwatch_test_support::needed;

/// Creates a certificate for localhost in `folder` with OpenSSL.
pub(crate) fn certificate(folder: &Path) -> TlsFiles {
    // Rustls rejects a CA certificate as a server certificate.
    self_signed(folder, "CA:FALSE")
}

/// Creates a certificate for localhost with these basic constraints.
pub(crate) fn self_signed(folder: &Path, constraints: &str) -> TlsFiles {
    let files = TlsFiles { certificate: folder.join("c.pem"), key: folder.join("k.pem") };
    let request = folder.join("request.cnf");
    let extensions = format!("basicConstraints = critical,{constraints}\nsubjectAltName = IP:127.0.0.1\n");
    let names =
        "[req]\ndistinguished_name = dn\nx509_extensions = ext\nprompt = no\n[dn]\nCN = localhost\n[ext]\n";
    std::fs::write(&request, format!("{names}{extensions}")).unwrap();
    let made = Command::new("openssl")
        .args([
            "req",
            "-x509",
            "-newkey",
            "ec",
            "-pkeyopt",
            "ec_paramgen_curve:prime256v1",
            "-nodes",
            "-days",
            "2",
        ])
        .arg("-config")
        .arg(&request)
        .arg("-keyout")
        .arg(&files.key)
        .arg("-out")
        .arg(&files.certificate)
        .output();
    let found = made.ok().filter(|output| output.status.success()).map(|_| files);
    needed(found, "openssl")
}
