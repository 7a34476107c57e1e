//! Certificates: an authority for the fleet, and one certificate per identity.
//!
//! Keys are ECDSA on P-256, which every TLS library supports. The folder of each identity holds all that
//! its host needs; the key of the authority stays where it was made.

use std::io::Write;
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};

use anyhow::Context;
use base64::Engine as _;
use muster_runtime::exit::ExitError;
use muster_runtime::store::read_at_most;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, PKCS_ECDSA_P256_SHA256, SanType,
};
use time::{Duration, OffsetDateTime};
use x509_parser::extensions::GeneralName;
use x509_parser::pem::parse_x509_pem;

use super::fleet::{FleetFile, Identity, Kind};

/// The certificate of an identity or of the authority.
pub(super) const CERTIFICATE: &str = "certificate.pem";

/// The private key of the certificate.
pub(super) const KEY: &str = "key.pem";

/// A copy of the authority's certificate in the folder of each identity.
pub(super) const AUTHORITY: &str = "authority.pem";

/// Zenoh's configuration of a client, with its certificate and key embedded.
const CLIENT_CONFIG: &str = "zenoh.json5";

/// The folder of the authority.
const AUTHORITY_FOLDER: &str = "authority";

/// Access to the folders: for their owner only, since they hold secrets.
const FOLDER_MODE: u32 = 0o700;

/// Access to a secret: its owner may read and write it.
pub(super) const SECRET_MODE: u32 = 0o600;

/// Access to a certificate: any user may read it.
pub(super) const PUBLIC_MODE: u32 = 0o644;

/// Largest certificate or key in bytes that is read back.
const MAX_PEM: u64 = 64 * 1024;

const SECONDS_PER_DAY: i64 = 24 * 60 * 60;

/// Arguments of `muster deploy certs`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Makes OUT/authority (keep its key.pem off the network: it can forge every identity), and for \
each router, host, service, robot, operator, viewer and bridge a folder such as OUT/robot.r1 \
(OUT/robot.r1.site-2 in another fleet of the file) with certificate.pem, \
key.pem, authority.pem and, for clients, zenoh.json5, which embeds all of them. Valid \
certificates are kept; the authority is never replaced.\n\nExamples:\n  \
muster deploy certs --fleet-file fleet.toml --out identities\n  \
muster deploy certs --fleet-file fleet.toml --out identities --force                  renew all\n  \
muster deploy certs --fleet-file fleet.toml --out identities --force --only robot.r1   renew one\n  \
muster-ingest --zenoh-config identities/service.ingest/zenoh.json5                    use one"
)]
pub(crate) struct CertsArgs {
    /// The file that names all members of the fleet; deploy/fleet.toml is an example
    #[arg(long, value_name = "FILE")]
    fleet_file: PathBuf,
    /// The folder of all identities
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Only these identities, such as robot.r1 or, of a further fleet, robot.r1.site-2, with commas
    #[arg(long, value_name = "KIND.NAME", value_delimiter = ',')]
    only: Vec<String>,
    /// Replace existing certificates
    #[arg(long)]
    force: bool,
}

/// The certificate authority.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    certificate: String,
}

/// Makes missing certificates; with `--force` it replaces all but that of the authority.
///
/// # Errors
/// Names the file that is invalid or cannot be written.
pub(super) fn run(args: &CertsArgs) -> anyhow::Result<()> {
    let fleet = FleetFile::read(&args.fleet_file)?;
    let chosen = choose(&fleet, &args.only)?;
    let mut out = std::io::stdout().lock();
    make_folder(&args.out)?;
    let authority = authority(&fleet, &args.out.join(AUTHORITY_FOLDER), &mut out)?;
    for identity in chosen {
        let folder = args.out.join(identity.to_string());
        let there = [CERTIFICATE, KEY].iter().all(|name| folder.join(name).exists());
        let mut made = "made";
        if there && !args.force {
            let pem = |name| read(&folder.join(name));
            let certificate = pem(CERTIFICATE)?;
            match state(&fleet, &identity, &folder, &certificate, &authority)? {
                State::Valid { days } => {
                    writeln!(out, "{identity}: kept, valid for {days} more days")?;
                    // The routers in the configuration of a client may have changed.
                    write_identity(
                        &fleet,
                        &identity,
                        &folder,
                        &certificate,
                        &pem(KEY)?,
                        &authority,
                    )?;
                    continue;
                }
                State::Replace { reason } => made = reason,
            }
        }
        let (certificate, key) = certify(&fleet, &identity, &authority)
            .with_context(|| format!("cannot certify {identity}"))?;
        make_folder(&folder)?;
        // After a crash an old certificate with a new key would look complete.
        remove(&folder.join(CERTIFICATE))?;
        write_identity(&fleet, &identity, &folder, &certificate, &key, &authority)?;
        writeln!(out, "{identity}: {made}, valid for {} days", fleet.certificate_days)?;
    }
    Ok(())
}

/// The state of an existing certificate.
enum State {
    /// It stays valid for so many days.
    Valid { days: i64 },
    /// It must be replaced.
    Replace { reason: &'static str },
}

/// The state of the certificate of an identity: no link opens with a certificate of another authority, or
/// without all addresses of its router.
fn state(
    fleet: &FleetFile,
    identity: &Identity,
    folder: &Path,
    certificate: &str,
    authority: &Authority,
) -> anyhow::Result<State> {
    let of = folder.join(AUTHORITY);
    if !of.exists() || read(&of)? != authority.certificate {
        return Ok(State::Replace { reason: "replaced, because the authority is another" });
    }
    let path = folder.join(CERTIFICATE);
    let damaged = |error: String| damaged(&path, &error);
    let (_, pem) = parse_x509_pem(certificate.as_bytes()).map_err(|e| damaged(e.to_string()))?;
    let parsed = pem.parse_x509().map_err(|error| damaged(error.to_string()))?;
    // An identity of another fleet may have had this folder, when that stood first in the file.
    let name = parsed.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
    if name != Some(fleet.common_name(identity).as_str()) {
        return Ok(State::Replace { reason: "replaced, because its name has changed" });
    }
    let names = parsed.subject_alternative_name().map_err(|error| damaged(error.to_string()))?;
    let named = |address: &String| {
        let mut names = names.iter().flat_map(|names| &names.value.general_names);
        match address.parse::<IpAddr>() {
            Ok(IpAddr::V4(address)) => {
                names.any(|name| *name == GeneralName::IPAddress(&address.octets()))
            }
            Ok(IpAddr::V6(address)) => {
                names.any(|name| *name == GeneralName::IPAddress(&address.octets()))
            }
            Err(_) => names.any(|name| *name == GeneralName::DNSName(address)),
        }
    };
    let router = fleet.routers.iter().find(|router| router.name == identity.name);
    let router = router.filter(|_| identity.kind == Kind::Router);
    if router.is_some_and(|router| !router.addresses.iter().all(named)) {
        return Ok(State::Replace { reason: "replaced, because its addresses have changed" });
    }
    let left = parsed.validity().not_after.timestamp() - OffsetDateTime::now_utc().unix_timestamp();
    if left <= 0 {
        return Ok(State::Replace { reason: "replaced, because it was no longer valid" });
    }
    Ok(State::Valid { days: left / SECONDS_PER_DAY })
}

fn choose(fleet: &FleetFile, only: &[String]) -> Result<Vec<Identity>, ExitError> {
    let mut all = fleet.identities();
    let known = |name: &String| all.iter().any(|identity| identity.to_string() == *name);
    if let Some(unknown) = only.iter().find(|name| !known(name)) {
        let unknown = muster_wire::message::quoted(unknown);
        return Err(ExitError::usage(format!(
            "--only: {unknown:?} is not in the fleet file; write identities like robot.r1"
        )));
    }
    all.retain(|identity| only.is_empty() || only.contains(&identity.to_string()));
    Ok(all)
}

/// The authority in the folder; created if there is none.
fn authority(fleet: &FleetFile, folder: &Path, out: &mut dyn Write) -> anyhow::Result<Authority> {
    let (certificate_path, key_path) = (folder.join(CERTIFICATE), folder.join(KEY));
    match (certificate_path.exists(), key_path.exists()) {
        (true, true) => {
            let (certificate, key) = (read(&certificate_path)?, read(&key_path)?);
            let key =
                KeyPair::from_pem(&key).map_err(|error| damaged(&key_path, &error.to_string()))?;
            let issuer = Issuer::from_ca_cert_pem(&certificate, key)
                .map_err(|error| damaged(&certificate_path, &error.to_string()))?;
            writeln!(out, "authority: kept")?;
            Ok(Authority { issuer, certificate })
        }
        (false, false) => {
            let key = KeyPair::generate_for(&PKCS_ECDSA_P256_SHA256)?;
            let mut params = CertificateParams::default();
            params.distinguished_name = rcgen::DistinguishedName::new();
            params
                .distinguished_name
                .push(DnType::CommonName, format!("muster authority {}", fleet.first().name));
            params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
            params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
            (params.not_before, params.not_after) = validity(fleet.authority_days)?;
            let certificate = params.self_signed(&key)?.pem();
            make_folder(folder)?;
            write(&key_path, &key.serialize_pem(), SECRET_MODE)?;
            write(&certificate_path, &certificate, PUBLIC_MODE)?;
            writeln!(out, "authority: made, valid for {} days", fleet.authority_days)?;
            Ok(Authority { issuer: Issuer::new(params, key), certificate })
        }
        (has_certificate, _) => {
            let missing = if has_certificate { key_path } else { certificate_path };
            Err(ExitError::usage(format!(
                "{} is missing; put it back, or remove the whole folder {} for a new authority, which \
                 makes all certificates invalid",
                missing.display(),
                folder.display()
            ))
            .into())
        }
    }
}

fn damaged(path: &Path, problem: &str) -> ExitError {
    ExitError::usage(format!(
        "{} cannot be used: {problem}; put the right file back",
        path.display()
    ))
}

fn certify(
    fleet: &FleetFile,
    identity: &Identity,
    authority: &Authority,
) -> anyhow::Result<(String, String)> {
    let key = KeyPair::generate_for(&PKCS_ECDSA_P256_SHA256)?;
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, fleet.common_name(identity));
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    // Only certificates of routers are valid for servers.
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    params.use_authority_key_identifier_extension = true;
    (params.not_before, params.not_after) = validity(fleet.certificate_days)?;
    if identity.kind == Kind::Router {
        params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        let router = fleet.routers.iter().find(|router| router.name == identity.name);
        for address in router.iter().flat_map(|router| &router.addresses) {
            params.subject_alt_names.push(match address.parse::<IpAddr>() {
                Ok(address) => SanType::IpAddress(address),
                Err(_) => SanType::DnsName(address.as_str().try_into()?),
            });
        }
    }
    let certificate = params.signed_by(&key, &authority.issuer)?;
    Ok((certificate.pem(), key.serialize_pem()))
}

/// From yesterday on, so that a host whose clock is behind accepts the certificate.
fn validity(days: u32) -> anyhow::Result<(OffsetDateTime, OffsetDateTime)> {
    let now = OffsetDateTime::now_utc();
    let moment = |days: i64| {
        now.checked_add(Duration::days(days)).context("the clock of this host is out of range")
    };
    Ok((moment(-1)?, moment(i64::from(days))?))
}

fn write_identity(
    fleet: &FleetFile,
    identity: &Identity,
    folder: &Path,
    certificate: &str,
    key: &str,
    authority: &Authority,
) -> anyhow::Result<()> {
    write(&folder.join(KEY), key, SECRET_MODE)?;
    write(&folder.join(AUTHORITY), &authority.certificate, PUBLIC_MODE)?;
    if identity.kind != Kind::Router {
        let text = client_config(fleet, identity, &authority.certificate, certificate, key)?;
        write(&folder.join(CLIENT_CONFIG), &text, SECRET_MODE)?;
    }
    // Last, so that a folder with a certificate is complete.
    write(&folder.join(CERTIFICATE), certificate, PUBLIC_MODE)
}

/// Zenoh's configuration for a client: addresses of the routers, certificates and key.
fn client_config(
    fleet: &FleetFile,
    identity: &Identity,
    authority: &str,
    certificate: &str,
    key: &str,
) -> anyhow::Result<String> {
    let endpoints: Vec<_> = fleet.routers.iter().map(|router| fleet.endpoint(router)).collect();
    let endpoints = serde_json::to_string(&endpoints)?;
    Ok(format!(
        "// Zenoh's configuration of {identity} of {whose}. Keep it secret: it holds the key.
{{
  // Whose file this is: operators command under this name.
  metadata: {{ identity: \"{identity}\" }},
  // Through a router; clients do not link with each other.
  mode: \"client\",
  // Routers in the order in which they are tried; when one is lost, the next is used.
  connect: {{ endpoints: {endpoints} }},
  // No discovery: what can be discovered can be forged.
  scouting: {{ multicast: {{ enabled: false }}, gossip: {{ enabled: false }} }},
  transport: {{
    // Milliseconds after which the next router is tried if one does not answer.
    unicast: {{ open_timeout: 2000 }},
    link: {{
      // No link without certificates, even if an endpoint is changed by mistake.
      protocols: [\"{protocol}\"],
      tls: {{
        // Show a certificate of our own (mutual TLS).
        enable_mtls: true,
        // Refuse a router whose certificate does not name the address that we connect to.
        verify_name_on_connect: true,
        // Close the link when the certificate of the router expires.
        close_link_on_expiration: true,
        // Who must have signed the router's certificate (authority.pem).
        root_ca_certificate_base64: \"{authority}\",
        // Our certificate (certificate.pem) …
        connect_certificate_base64: \"{certificate}\",
        // … and its key (key.pem).
        connect_private_key_base64: \"{key}\",
      }},
    }},
  }},
}}
",
        identity = identity.in_fleet(),
        whose = fleet.whose(identity),
        protocol = fleet.protocol,
        authority = base64(authority),
        certificate = base64(certificate),
        key = base64(key),
    ))
}

/// The form in which Zenoh reads a file that is embedded in its configuration.
pub(super) fn base64(text: &str) -> String {
    base64::engine::general_purpose::STANDARD.encode(text)
}

/// Creates a folder for its owner only; an existing one stays as it is.
fn make_folder(folder: &Path) -> anyhow::Result<()> {
    std::fs::DirBuilder::new()
        .recursive(true)
        .mode(FOLDER_MODE)
        .create(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))
}

fn remove(path: &Path) -> anyhow::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}

pub(super) fn read(path: &Path) -> anyhow::Result<String> {
    let fail = || format!("cannot read {}", path.display());
    String::from_utf8(read_at_most(path, MAX_PEM).with_context(fail)?).with_context(fail)
}

/// Replaces a file atomically; a secret is never readable by others meanwhile.
pub(super) fn write(path: &Path, text: &str, mode: u32) -> anyhow::Result<()> {
    let fail = || format!("cannot write {}", path.display());
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let mut file =
        tempfile::NamedTempFile::new_in(folder.unwrap_or(Path::new("."))).with_context(fail)?;
    file.write_all(text.as_bytes()).with_context(fail)?;
    file.as_file().set_permissions(std::fs::Permissions::from_mode(mode)).with_context(fail)?;
    file.as_file().sync_all().with_context(fail)?;
    file.persist(path).with_context(fail)?;
    Ok(())
}
