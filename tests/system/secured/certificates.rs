//! Certificates and rules as `muster deploy` makes them.

use muster_tests::process::run;

use super::{SOON, deploy, fleet_file, text};

#[test]
fn certificates_are_kept_renewed_and_guarded() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_file(folder.path(), "\"a1\"", &["base"]);
    let out = folder.path().join("identities");
    let certs = |more: &[&str]| {
        deploy(&[&["certs", "--fleet-file", text(&fleet), "--out", text(&out)], more].concat())
    };
    assert!(certs(&[]).contains("robot.a1: made"));
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    for name in ["authority", "router.base", "service.ingest", "robot.a1", "operator.op"] {
        let mode = |file: &str| {
            std::fs::metadata(out.join(name).join(file)).unwrap().permissions().mode() & 0o777
        };
        assert_eq!(mode("key.pem"), 0o600, "{name}");
        assert_eq!(mode(""), 0o700, "{name}");
        if name.starts_with(['s', 'o']) || name == "robot.a1" {
            assert_eq!(mode("zenoh.json5"), 0o600, "{name}");
        }
    }
    let keys =
        || ["authority", "robot.a1", "operator.op"].map(|name| read(&format!("{name}/key.pem")));
    let before = keys();
    // A robot that joins later is signed by the same authority, and nothing else changes.
    let joined = std::fs::read_to_string(&fleet).unwrap().replace("\"a1\"", "\"a1\", \"a2\"");
    std::fs::write(&fleet, joined).unwrap();
    let printed = certs(&[]);
    assert!(printed.contains("robot.a1: kept") && printed.contains("robot.a2: made"), "{printed}");
    assert_eq!(keys(), before);
    assert_eq!(read("robot.a2/authority.pem"), read("authority/certificate.pem"));
    // A router that is reached by another name needs a certificate that names it.
    let moved = std::fs::read_to_string(&fleet).unwrap().replace("\"127.0.0.1\"", "\"base.local\"");
    std::fs::write(&fleet, moved).unwrap();
    let printed = certs(&[]);
    assert!(printed.contains("router.base: replaced, because its addresses"), "{printed}");
    assert!(printed.contains("robot.a1: kept, valid for 36"), "{printed}");
    assert!(certs(&[]).contains("router.base: kept"));
    certs(&["--force", "--only", "robot.a1"]);
    let renewed = keys();
    assert_eq!((&renewed[0], &renewed[2]), (&before[0], &before[2]));
    assert_ne!(renewed[1], before[1]);
    // The identity of another fleet is no identity of this one.
    let other = std::fs::read_to_string(&fleet).unwrap().replace("\"alpha\"", "\"beta\"");
    std::fs::write(&fleet, other).unwrap();
    let printed = certs(&[]);
    assert!(printed.contains("robot.a1: replaced, because its name has changed"), "{printed}");

    let (fleet, out) = (text(&fleet), text(&out));
    let fails = |arguments: &[&str], word: &str| {
        let (code, _, err) = run("muster", &[&["deploy"], arguments].concat(), SOON).unwrap();
        assert_eq!(code, Some(2), "{arguments:?}: {err}");
        assert!(err.contains(word), "{arguments:?}: {err}");
    };
    fails(&["certs", "--fleet-file", fleet, "--out", out, "--only", "robot.zz"], "--only");
    fails(&["certs", "--fleet-file", "/none.toml", "--out", out], "/none.toml");
    let router = folder.path().join("router.json5");
    let acl = ["acl", "--fleet-file", fleet, "--out", text(&router)];
    deploy(&acl);
    fails(&acl, "--force");
    fails(&["acl", "--fleet-file", fleet, "--out", text(&router), "--router", "x"], "--router");
    std::fs::remove_file(folder.path().join("identities/authority/key.pem")).unwrap();
    fails(&["certs", "--fleet-file", fleet, "--out", out], "key.pem is missing");
    // With a new authority, the certificates of the old one open no link.
    std::fs::remove_dir_all(folder.path().join("identities/authority")).unwrap();
    let printed = deploy(&["certs", "--fleet-file", fleet, "--out", out]);
    assert!(printed.contains("authority: made, valid"), "{printed}");
    assert!(printed.contains("robot.a1: replaced, because the authority"), "{printed}");
    assert!(!printed.contains("kept"), "{printed}");
}
