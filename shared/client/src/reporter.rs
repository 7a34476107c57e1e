//! What a robot reports: checked, numbered, stamped, and republished while it is valid.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use muster_model::id::{Modality, RobotId};
use muster_model::limits::MAX_DECLARED_MODALITIES;
use muster_model::observation::{CheckedReport, Provenance, Report, Stream};
use muster_model::replay::REPLAY_PREFIX;
use muster_model::time::Tick;
use muster_wire::{Format, Message, Outbound};

use crate::error::Error;

/// A report that is valid until the next one of its stream.
#[derive(Debug)]
struct Valid {
    report: CheckedReport,
    published: Instant,
}

/// Makes messages of the reports of one robot.
#[derive(Debug)]
pub(crate) struct Reporter {
    robot: RobotId,
    format: Format,
    boot: String,
    sequences: BTreeMap<Stream, u64>,
    valid: BTreeMap<Stream, Valid>,
}

/// A name for one run of a robot's software, which no other run has.
fn new_boot() -> String {
    // The keys of the standard hasher are random, so that two robots that start in the same
    // microsecond differ all the same.
    let random = RandomState::new().build_hasher().finish();
    format!("{:x}-{random:x}", wall_clock().0)
}

/// Now, by the clock of the host. It is read each time: many robots set it after they start.
pub(crate) fn wall_clock() -> Tick {
    Tick(0).after(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

impl Reporter {
    pub(crate) fn new(robot: RobotId, format: Format) -> Self {
        Self { robot, format, boot: new_boot(), sequences: BTreeMap::new(), valid: BTreeMap::new() }
    }

    /// The same for a robot of a recording: its boot id says so.
    pub(crate) fn replay(robot: RobotId, format: Format) -> Self {
        let boot = format!("{REPLAY_PREFIX}{}", new_boot());
        Self { boot, ..Self::new(robot, format) }
    }

    /// The robot.
    pub(crate) fn robot(&self) -> &RobotId {
        &self.robot
    }

    /// The boot id: the name of this run of the robot's software.
    pub(crate) fn boot(&self) -> &str {
        &self.boot
    }

    /// The message of a report, to be put now.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong.
    pub(crate) fn publish(&mut self, now: Instant, report: Report) -> Result<Outbound, Error> {
        let stream = report.stream();
        if let Stream::Relation(modality) = &stream {
            self.check_modality(&stream, modality)?;
        }
        let report = CheckedReport::new(self.robot.clone(), report)?;
        let outbound = self.encode(&stream, report.clone())?;
        if stream != Stream::Pose {
            self.valid.insert(stream, Valid { report, published: now });
        }
        Ok(outbound)
    }

    fn check_modality(&self, stream: &Stream, modality: &Modality) -> Result<(), Error> {
        if modality.is_built_in() {
            let problem =
                format!("{modality} is made from poses, links or ranks; name a declared modality");
            return Err(Error::input("modality", problem));
        }
        let is_relation = |stream: &&Stream| matches!(stream, Stream::Relation(_));
        let relations = self.valid.keys().filter(is_relation).count();
        if relations >= MAX_DECLARED_MODALITIES && !self.valid.contains_key(stream) {
            let problem = format!("a fleet declares at most {MAX_DECLARED_MODALITIES}");
            return Err(Error::input("modality", problem));
        }
        Ok(())
    }

    /// The messages of all valid reports that were last published before a moment.
    pub(crate) fn republish(&mut self, now: Instant, before: Instant) -> Vec<Outbound> {
        let due: Vec<(Stream, CheckedReport)> = self
            .valid
            .iter_mut()
            .filter(|(_, valid)| valid.published <= before)
            .map(|(stream, valid)| {
                valid.published = now;
                (stream.clone(), valid.report.clone())
            })
            .collect();
        let encoded = due.into_iter().map(|(stream, report)| self.encode(&stream, report));
        encoded
            .filter_map(|outbound| {
                outbound.inspect_err(|error| tracing::debug!("not republished: {error}")).ok()
            })
            .collect()
    }

    /// The report as a message: with boot id and sequence number, and with a stamp if it has none.
    fn encode(&mut self, stream: &Stream, report: CheckedReport) -> Result<Outbound, Error> {
        let number = self.sequences.entry(stream.clone()).or_default();
        *number += 1;
        let now = wall_clock();
        let provenance = Provenance {
            stamp: report.report().provenance().stamp.or(Some(now.as_seconds())),
            boot: Some(self.boot.clone()),
            seq: Some(*number),
        };
        encode(report.with_provenance(provenance)?, self.format, now)
    }
}

/// A report as a message, with boot id, sequence number and stamp as they are.
///
/// # Errors
/// [`Error::Input`] if it is too large.
pub(crate) fn encode(report: CheckedReport, format: Format, now: Tick) -> Result<Outbound, Error> {
    let field = report.stream().list_field();
    let message = Message::Report(report);
    let outbound = message.encode(message.keys().0, format, now);
    let outbound = outbound.map_err(|error| Error::input(field, error.to_string()))?;
    let (size, limit) = (outbound.payload.len(), outbound.key.payload_limit());
    if size > limit {
        let problem = format!("takes {size} bytes, more than the limit of {limit}");
        return Err(Error::input(field, problem));
    }
    Ok(outbound)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use muster_model::id::FleetId;
    use muster_model::limits::{MAX_ID_LENGTH, MAX_LINKS, MAX_RELATION_EDGES};
    use muster_model::observation::{Link, Links, Pose, Rank, Relation};
    use muster_wire::KeySpace;

    use super::*;

    fn id(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn reporter() -> Reporter {
        Reporter::new(id("r1"), Format::Json)
    }

    /// What a service decodes of it.
    fn decoded(outbound: Outbound) -> (Report, Provenance) {
        let space = KeySpace::new(FleetId::new("f").unwrap());
        let packet = outbound.into_packet(&space);
        let message = Message::decode(&space, &packet).unwrap();
        let Message::Report(report) = message else { panic!("{message:?}") };
        let report = report.into_parts().1;
        let provenance = report.provenance();
        (report, provenance)
    }

    fn links(peers: impl IntoIterator<Item = String>) -> Report {
        let links = peers.into_iter().map(|peer| Link { peer: id(&peer), quality: 0.123_456_789 });
        Report::Links(Links { links: links.collect(), stamp: None, boot: None, seq: None })
    }

    fn relation(edges: Vec<(RobotId, RobotId, f64)>) -> Relation {
        Relation { edges, stamp: None, boot: None, seq: None }
    }

    #[test]
    fn each_stream_counts_by_itself_within_one_run() {
        let (mut reporter, now) = (reporter(), Instant::now());
        let mut numbered = Vec::new();
        for report in [
            Report::Pose(Pose::at(1.0, 2.0)),
            Report::Pose(Pose { stamp: Some(7.0), ..Pose::at(1.0, 2.0) }),
            Report::Rank(Rank::under(None)),
        ] {
            let (_, provenance) = decoded(reporter.publish(now, report).unwrap());
            assert_eq!(provenance.boot.as_deref(), Some(reporter.boot()));
            numbered.push((provenance.seq, provenance.stamp));
        }
        assert_eq!(
            numbered.iter().map(|(seq, _)| *seq).collect::<Vec<_>>(),
            [Some(1), Some(2), Some(1)]
        );
        assert_eq!(numbered[1].1, Some(7.0), "the stamp of a sensor is kept");
        assert!((numbered[0].1.unwrap() - wall_clock().as_seconds()).abs() < 60.0);
        assert_ne!(new_boot(), new_boot());
        assert!(new_boot().len() <= muster_model::limits::MAX_TEXT_LENGTH);
    }

    #[test]
    fn valid_reports_are_republished_with_higher_numbers_and_poses_are_not() {
        let (mut reporter, start) = (reporter(), Instant::now());
        let later = start + Duration::from_secs(1);
        reporter.publish(start, Report::Pose(Pose::at(0.0, 0.0))).unwrap();
        reporter.publish(start, Report::Rank(Rank::under(Some(id("r0"))))).unwrap();
        reporter.publish(start, links(["r2".to_owned()])).unwrap();
        reporter.publish(later, links(["r3".to_owned()])).unwrap();
        let due = reporter.republish(later, start);
        assert_eq!(due.len(), 1, "the links are young");
        let (report, provenance) = decoded(due.into_iter().next().unwrap());
        assert!(matches!(report, Report::Rank(_)));
        assert_eq!(provenance.seq, Some(2));
        let all: Vec<_> = reporter.republish(later, later).into_iter().map(decoded).collect();
        assert_eq!(all.len(), 2);
        let newest = |(report, _): &(Report, Provenance)| match report {
            Report::Links(links) => links.links[0].peer == id("r3"),
            _ => false,
        };
        assert!(all.iter().any(newest), "the newest is republished");
    }

    #[test]
    fn every_wrong_field_is_named_and_nothing_of_it_is_kept() {
        let (mut reporter, now) = (reporter(), Instant::now());
        let thermal = || Modality::new("thermal").unwrap();
        let me = || id("r1");
        let wrong = [
            ("x", Report::Pose(Pose::at(f64::NAN, 0.0))),
            ("heading", Report::Pose(Pose { heading: Some(f64::INFINITY), ..Pose::at(0.0, 0.0) })),
            ("frame", Report::Pose(Pose { frame: Some("m".repeat(65)), ..Pose::at(0.0, 0.0) })),
            ("links.peer", links(["r1".to_owned()])),
            ("links.peer", links(["r2".to_owned(), "r2".to_owned()])),
            ("links", links((0..=MAX_LINKS).map(|i| format!("p{i}")))),
            ("superior", Report::Rank(Rank::under(Some(me())))),
            ("weight", Report::Rank(Rank { weight: Some(-1.0), ..Rank::under(None) })),
            ("edges", Report::Relation(thermal(), relation(vec![(me(), id("r2"), f64::NAN)]))),
            ("edges", Report::Relation(thermal(), relation(vec![(id("r2"), me(), 1.0)]))),
            ("edges", Report::Relation(thermal(), relation(vec![(me(), me(), 1.0)]))),
            ("modality", Report::Relation(Modality::spatial(), relation(vec![]))),
        ];
        for (field, report) in wrong {
            let error = reporter.publish(now, report).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{field}: ")), "{error}");
        }
        assert!(reporter.republish(now, now).is_empty());
    }

    #[test]
    fn the_largest_reports_fit_and_modalities_are_bounded() {
        let now = Instant::now();
        let long = |i: usize| format!("{i:a>MAX_ID_LENGTH$}");
        let longest = RobotId::new("z".repeat(MAX_ID_LENGTH)).unwrap();
        for format in [Format::Json, Format::Binary] {
            let mut reporter = Reporter::new(longest.clone(), format);
            reporter.publish(now, links((0..MAX_LINKS).map(long))).unwrap();
            let edges = (0..MAX_RELATION_EDGES)
                .map(|i| (longest.clone(), id(&long(i)), 0.123_456_789_012_345_6));
            let edges = relation(edges.collect());
            for number in 0..MAX_DECLARED_MODALITIES {
                let modality = Modality::new(format!("m{number}")).unwrap();
                reporter.publish(now, Report::Relation(modality, edges.clone())).unwrap();
            }
            let more = Report::Relation(Modality::new("more").unwrap(), edges);
            assert!(reporter.publish(now, more).unwrap_err().to_string().contains("at most 16"));
        }
    }
}
