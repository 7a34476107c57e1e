//! The configuration of a secured router: mutual TLS, and rules that deny what they do not allow.
//!
//! A rule allows a message if its key expression includes that of the message. So no rule for one robot
//! allows a put to `robot/*/pose`. A rule that denied it would match exactly such puts only.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use muster_runtime::exit::ExitError;
use muster_wire::{FleetPattern, Pattern};

use super::certs::{AUTHORITY, CERTIFICATE, KEY, PUBLIC_MODE, SECRET_MODE, base64, read, write};
use super::fleet::{FleetFile, Identity, PROTOCOLS, Router};
use super::rights::Rights;

/// The router for trusted networks. The secured one is this text with the parts below inserted.
const PLAIN: &str = include_str!("../../../../deploy/router/plain.json5");

/// Folder of a router's identity on its host, unless it is embedded in the configuration.
const INSTALLED: &str = "/etc/muster/router";

/// Arguments of `muster deploy acl`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The file is the whole configuration of one router: TLS with certificates on both sides, and \
for each identity the keys that it may put, receive, get and answer. An identity that is not named may do \
nothing. A router reads the file when it starts.\n\nExamples:\n  \
muster deploy acl --fleet-file fleet.toml --out router.json5\n  \
muster deploy acl --fleet-file fleet.toml --identity identities/router.base --out router.json5\n  \
muster router --zenoh-config router.json5"
)]
pub(crate) struct AclArgs {
    /// The file that names all members of the fleet; deploy/fleet.toml is an example
    #[arg(long, value_name = "FILE")]
    fleet_file: PathBuf,
    /// Which router of the fleet file; optional if there is one
    #[arg(long, value_name = "NAME")]
    router: Option<String>,
    /// Embed the certificates and the key of this folder; without it the file names those in
    /// /etc/muster/router
    #[arg(long, value_name = "FOLDER")]
    identity: Option<PathBuf>,
    /// The file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
}

/// Writes the configuration of a router.
///
/// # Errors
/// Names the file that is invalid, exists already, or cannot be written.
pub(super) fn run(args: &AclArgs) -> anyhow::Result<()> {
    let fleet = FleetFile::read(&args.fleet_file)?;
    let router = fleet.router(args.router.as_deref())?;
    if args.out.exists() && !args.force {
        let out = args.out.display();
        return Err(
            ExitError::usage(format!("--out: {out} exists already; --force replaces it")).into()
        );
    }
    let tls = match &args.identity {
        Some(folder) => Tls::embedded(folder)?,
        None => Tls::installed(),
    };
    // With the key inside, the file is a secret itself.
    let mode = if args.identity.is_some() { SECRET_MODE } else { PUBLIC_MODE };
    write(&args.out, &router_config(&fleet, router, &tls)?, mode)?;
    writeln!(
        std::io::stdout(),
        "{}: written for {} identities",
        args.out.display(),
        fleet.identities().len()
    )?;
    Ok(())
}

/// The identity of a router and the authority that it trusts: names of files, or their content in base64.
struct Tls {
    suffix: &'static str,
    authority: String,
    certificate: String,
    key: String,
}

impl Tls {
    fn installed() -> Self {
        let of = |name: &str| format!("{INSTALLED}/{name}");
        Self { suffix: "", authority: of(AUTHORITY), certificate: of(CERTIFICATE), key: of(KEY) }
    }

    fn embedded(folder: &Path) -> anyhow::Result<Self> {
        let of = |name: &str| anyhow::Ok(base64(&read(&folder.join(name))?));
        Ok(Self {
            suffix: "_base64",
            authority: of(AUTHORITY)?,
            certificate: of(CERTIFICATE)?,
            key: of(KEY)?,
        })
    }
}

/// The text of the configuration of one router.
///
/// # Errors
/// If the plain configuration lacks a place where a part is inserted.
fn router_config(fleet: &FleetFile, router: &Router, tls: &Tls) -> anyhow::Result<String> {
    let listen = serde_json::to_string(&router.listens())?;
    let protocols = serde_json::to_string(&PROTOCOLS.map(|protocol| protocol.to_string()))?;
    // Each router links with those before it, so that each pair has one link.
    let before = fleet.routers.iter().take_while(|other| other.name != router.name);
    let connect =
        serde_json::to_string(&before.map(|other| fleet.endpoint(other)).collect::<Vec<_>>())?;
    let head = PLAIN.lines().take_while(|line| line.starts_with("//")).count();
    let mut text = format!(
        "// The Zenoh router {} of {}, for networks that are not trusted: every client shows a certificate,
// and may do only what is allowed below. Made by `muster deploy acl` from the fleet file; change that one.
//
//   muster router --zenoh-config FILE        or Zenoh's own:  zenohd --config FILE
",
        router.name,
        of_fleets(fleet)
    );
    for line in PLAIN.lines().skip(head) {
        text.push_str(line);
        text.push('\n');
    }
    let with_tls = tls_section(tls, &protocols);
    for (place, part) in [
        ("[\"tcp/0.0.0.0:7447\"]", listen.as_str()),
        ("    endpoints: [],\n", &format!("    endpoints: {connect},\n")),
        ("      // TLS: none.\n", &with_tls),
        ("  // Access control: none.\n", &access_control(fleet)?),
    ] {
        anyhow::ensure!(
            text.matches(place).count() == 1,
            "the plain router has no single {place:?}"
        );
        text = text.replace(place, part);
    }
    Ok(text)
}

/// Whose router it is, for people: a long list says no more than its length.
fn of_fleets(file: &FleetFile) -> String {
    const NAMED: usize = 5;
    match file.fleets.len() {
        1 => format!("fleet {}", file.names()),
        count if count <= NAMED => format!("fleets {}", file.names()),
        count => format!("{count} fleets"),
    }
}

/// The part of the configuration that makes links use TLS with certificates on both sides.
///
/// `protocols` is a JSON list.
fn tls_section(tls: &Tls, protocols: &str) -> String {
    format!(
        "      // No link without certificates, even if an endpoint is changed by mistake.
      protocols: {protocols},
      tls: {{
        // Every client must show a certificate (mutual TLS).
        enable_mtls: true,
        // A link ends when its certificate expires.
        close_link_on_expiration: true,
        // Who must have signed the certificates of clients and other routers.
        root_ca_certificate{suffix}: \"{authority}\",
        // The certificate that this router shows to clients …
        listen_certificate{suffix}: \"{certificate}\",
        // … and its key.
        listen_private_key{suffix}: \"{key}\",
        // The same towards other routers, of which this one is a client …
        connect_certificate{suffix}: \"{certificate}\",
        // … and its key.
        connect_private_key{suffix}: \"{key}\",
        // Refuse another router whose certificate does not name the address that we connect to.
        verify_name_on_connect: true,
      }},
",
        suffix = tls.suffix,
        authority = tls.authority,
        certificate = tls.certificate,
        key = tls.key,
    )
}

/// Rules, subjects and policies, one of each per identity and right.
fn access_control(fleet: &FleetFile) -> anyhow::Result<String> {
    let mut rules = Rules::default();
    let (mut subjects, mut policies) = (String::new(), String::new());
    let protocols = serde_json::to_string(&PROTOCOLS.map(|protocol| protocol.to_string()))?;
    rules.shared(fleet)?;
    for identity in fleet.identities() {
        let name = fleet.common_name(&identity);
        let used = match Rights::of(fleet, &identity) {
            Some(rights) => rules.of(&identity, &rights)?,
            None => vec!["trusted".to_owned()],
        };
        writeln!(
            subjects,
            "      {{ id: \"{identity}\", cert_common_names: [\"{name}\"], link_protocols: {protocols} }},"
        )?;
        let used = serde_json::to_string(&used)?;
        writeln!(policies, "      {{ subjects: [\"{identity}\"], rules: {used} }},")?;
    }
    Ok(format!(
        "  access_control: {{
    // Off would mean no control at all.
    enabled: true,
    // What no rule allows is dropped without an error.
    default_permission: \"deny\",
    // Ingress: from a client to the router. Egress: from the router to a client.
    rules: [
{rules}    ],
    // Identities: exactly the common name of the certificate, and only over links that show one.
    subjects: [
{subjects}    ],
    // Which rules hold for which identity.
    policies: [
{policies}    ],
  }},
",
        rules = rules.text
    ))
}

/// The text of rules.
#[derive(Default)]
struct Rules {
    text: String,
}

impl Rules {
    /// Adds a rule, unless it would allow nothing.
    fn add(
        &mut self,
        id: &str,
        why: &str,
        flow: &str,
        messages: &[&str],
        keys: &[String],
    ) -> anyhow::Result<bool> {
        if keys.is_empty() {
            return Ok(false);
        }
        let (messages, keys) = (serde_json::to_string(messages)?, serde_json::to_string(keys)?);
        writeln!(
            self.text,
            "      // {why}\n      {{ id: \"{id}\", permission: \"allow\", flows: [{flow}], messages: {messages}, key_exprs: {keys} }},"
        )?;
        Ok(true)
    }

    /// The rules that several identities share.
    fn shared(&mut self, file: &FleetFile) -> anyhow::Result<()> {
        const ALL: [&str; 9] = [
            "put",
            "delete",
            "declare_subscriber",
            "query",
            "declare_queryable",
            "reply",
            "liveliness_token",
            "declare_liveliness_subscriber",
            "liveliness_query",
        ];
        let everything = ["**".to_owned()];
        let why = "Routers relay everything to each other; each has checked its own clients.";
        self.add("trusted", why, "\"ingress\", \"egress\"", &ALL, &everything)?;
        let why = "Clients learn which subscribers and queryables exist: without that a publisher sends \
                   nothing.";
        let messages = ["declare_subscriber", "declare_queryable"];
        self.add("declarations", why, "\"egress\"", &messages, &everything)?;
        let why =
            "Who answers gets receives those of all identities that may get, wildcards included.";
        let fleets = file.fleets.iter().map(|fleet| FleetPattern::from(&fleet.name));
        let served = file.hosts.iter().flat_map(|host| host.fleets.iter().cloned());
        let fleets: BTreeSet<FleetPattern> = fleets.chain(served).collect();
        let keys: Vec<String> =
            fleets.iter().map(|fleet| fleet.keys(&Pattern::Everything)).collect();
        self.add("gets", why, "\"egress\"", &["query"], &keys)?;
        Ok(())
    }

    /// The rules of one identity; returns the ids of all that it has.
    fn of(&mut self, identity: &Identity, rights: &Rights) -> anyhow::Result<Vec<String>> {
        let (ingress, egress) = ("\"ingress\"", "\"egress\"");
        let mut used = vec!["declarations".to_owned()];
        if !rights.reply.is_empty() {
            used.push("gets".to_owned());
        }
        let all: [(&str, &str, &[&str], &Vec<String>); 9] = [
            ("puts", ingress, &["put"], &rights.put),
            ("subscribes to", ingress, &["declare_subscriber"], &rights.subscribe),
            ("receives", egress, &["put"], &rights.subscribe),
            ("gets", ingress, &["query"], &rights.get),
            ("receives replies to", egress, &["reply"], &rights.get),
            ("replies to", ingress, &["declare_queryable", "reply"], &rights.reply),
            ("declares the token", ingress, &["liveliness_token"], &rights.declare_token),
            (
                "watches",
                ingress,
                &["declare_liveliness_subscriber", "liveliness_query"],
                &rights.watch_token,
            ),
            ("receives tokens", egress, &["liveliness_token"], &rights.watch_token),
        ];
        for (verb, flow, messages, keys) in all {
            let id = format!("{identity} {verb}");
            if self.add(&id, &format!("{identity} {verb}:"), flow, messages, keys)? {
                used.push(id);
            }
        }
        Ok(used)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = include_str!("../../../../deploy/fleet.toml");
    const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/router/secured.json5");

    #[test]
    fn the_shipped_router_is_made_from_the_shipped_fleet() {
        let fleet = FleetFile::parse(EXAMPLE).unwrap();
        let text = router_config(&fleet, &fleet.routers[0], &Tls::installed()).unwrap();
        if std::env::var_os("UPDATE_GOLDEN").is_some() {
            std::fs::write(SHIPPED, &text).unwrap();
        }
        let shipped = std::fs::read_to_string(SHIPPED).unwrap();
        assert_eq!(
            shipped, text,
            "run this test with UPDATE_GOLDEN=1 after a change of keys or rules"
        );
        muster_runtime::bus::check_zenoh_config(Path::new(SHIPPED)).unwrap();
    }

    #[test]
    fn later_routers_link_with_earlier_ones() {
        let two = EXAMPLE.to_owned()
            + "\n[[routers]]\nname = \"spare\"\naddresses = [\"spare.local\"]\nport = 7448\n";
        let fleet = FleetFile::parse(&two).unwrap();
        let text =
            |index: usize| router_config(&fleet, &fleet.routers[index], &Tls::installed()).unwrap();
        assert!(text(0).contains("    endpoints: [],\n"));
        assert!(text(1).contains("    endpoints: [\"quic/base.local:7447\"],\n"));
        assert!(text(1).contains("[\"quic/0.0.0.0:7448\",\"tls/0.0.0.0:7448\"]"));
        assert!(text(1).contains("{ subjects: [\"router.spare\"], rules: [\"trusted\"] }"));
    }
}
