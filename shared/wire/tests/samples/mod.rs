//! One message of every kind, with every field filled.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::alert::{Acknowledgement, Alert, AlertKind, AlertSubject, Alerts};
use muster_model::audit::{
    Audit, Flapping, Quality, RobotReturns, SilhouetteMethod, SilhouetteReport, Space,
};
use muster_model::command::{CommandOutcome, SettingsChange};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingGraph, EmbeddingMode, EmbeddingQuality};
use muster_model::event::{Event, EventKind, Severity};
use muster_model::graph::{GraphDelta, GraphRow};
use muster_model::header::{Header, Revision, StageTime};
use muster_model::history::{
    Coverage, DivisionRow, EventCoverage, EventRow, HistoryAnswer, LeaveReason, PastAudit,
    PastDivision, PastTeam, PlaceRow, RecordingState, Rows, SnapshotCause, StayRow, TeamMean,
    TeamRow,
};
use muster_model::id::{
    CommandId, FleetId, InstanceId, Modality, OperatorId, ProposalId, RobotId, ServiceName,
    SkillId, TeamId, WishId,
};
use muster_model::katz::{PairMethod, PairSimilarity};
use muster_model::observation::{CheckedReport, Link, Links, Pose, Rank, Relation, Report};
use muster_model::proposal::{
    DivisionQuality, LiveTeam, Proposal, ProposalReport, ProposalRequest, ProposalState,
    ProposedDivision, ProposedMove, ProposedTeam,
};
use muster_model::refused::Refused;
use muster_model::remembered::RememberedTeams;
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::status::{Departure, ServiceStatus};
use muster_model::team_audit::{
    Conductance, LeastFitting, Loss, Radio, SkillCover, Spread, TeamAudit,
};
use muster_model::teams::{
    HeldRobot, Limited, Member, SkillPrices, Team, TeamChange, TeamCountScore, TeamNeed, Teams,
};
use muster_model::time::Tick;
use muster_model::why::{DecidedBy, ModalityPull, Reason, ReasonWish, TeamReason, Why};
use muster_model::wish::{StandingWish, Wish, WishKind, WishList, WishReport, WishState};
use muster_wire::Message;
use muster_wire::envelope::AnnouncedSettings;

/// The moment at which all samples are written.
pub(crate) const NOW: Tick = Tick(1_795_208_990_000_000);

pub(crate) fn fleet() -> FleetId {
    FleetId::new("alpha").unwrap()
}

pub(crate) fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

fn skill(name: &str) -> SkillId {
    SkillId::new(name).unwrap()
}

fn team(name: &str) -> TeamId {
    TeamId::new(name).unwrap()
}

fn revision(epoch: u64) -> Revision {
    Revision { term: 3, epoch }
}

pub(crate) fn header(epoch: u64) -> Header {
    let tick = |ms: u64| Tick(NOW.0 - 1_000_000 + ms * 1000);
    Header {
        fleet: fleet(),
        revision: revision(epoch),
        oldest: Some(tick(0)),
        newest: Some(tick(90)),
        stages: vec![
            StageTime { stage: ServiceName::Ingest, received: tick(90), published: tick(100) },
            StageTime { stage: ServiceName::Embedder, received: tick(101), published: tick(110) },
        ],
    }
}

fn from_robot(name: &str, report: impl Into<Report>) -> Message {
    Message::Report(CheckedReport::new(robot(name), report).unwrap())
}

fn provenance() -> (Option<f64>, Option<String>, Option<u64>) {
    (Some(1_795_208_988.7), Some("a1".to_owned()), Some(17))
}

pub(crate) fn all() -> Vec<(&'static str, Message)> {
    let (stamp, boot, seq) = provenance();
    let pose = Pose {
        x: 1.0,
        y: -2.5,
        z: Some(0.0),
        heading: Some(0.5),
        frame: Some("map".to_owned()),
        stamp,
        boot: boot.clone(),
        seq,
    };
    let links = Links {
        links: vec![Link { peer: robot("r2"), quality: 0.93 }],
        stamp,
        boot: boot.clone(),
        seq,
    };
    let rank = Rank {
        skills: None,
        superior: Some(robot("r1")),
        weight: Some(1.0),
        role: Some("rifleman".to_owned()),
        stamp,
        boot: boot.clone(),
        seq,
    };
    let skilled_rank = Rank { skills: Some(vec![skill("relay"), skill("medic")]), ..rank.clone() };
    let relation = Relation { edges: vec![(robot("r1"), robot("r2"), 0.25)], stamp, boot, seq };
    let graph = GraphDelta {
        header: header(42),
        modality: Modality::hierarchy(),
        base: Some(revision(40)),
        nodes_added: vec![(0, robot("r1")), (7, robot("r2"))],
        nodes_removed: vec![5],
        rows: vec![GraphRow { source: 0, edges: vec![(7, 1.0)] }],
    };
    let roster = Roster {
        header: header(42),
        robots: vec![RosterEntry {
            node: 0,
            robot: robot("r1"),
            presence: Presence::Stale,
            position: Some([1.0, -2.5, 0.0]),
            heading: Some(0.5),
            frame: Some("map".to_owned()),
            superior: Some(robot("r9")),
            role: Some("leader".to_owned()),
            skills: vec![skill("medic"), skill("relay")],
            last_seen: Tick(NOW.0 - 3_000_000),
        }],
        graphs: vec![(Modality::hierarchy(), revision(42)), (Modality::spatial(), revision(41))],
    };
    let embedding = Embedding {
        header: header(43),
        roster: revision(42),
        graphs: vec![EmbeddingGraph {
            modality: Modality::hierarchy(),
            revision: revision(42),
            weight: 0.6,
            trust: 0.75,
        }],
        robots: vec![robot("r1"), robot("r2")],
        dimension: 2,
        values: vec![0.25, -0.5, 0.0, 0.0],
        without_embedding: vec![false, true],
        provisional: vec![true, false],
        centrality: vec![1.5, 1.0],
        quality: EmbeddingQuality {
            spectral_radius: (0.5, 0.5),
            alpha: 1.0,
            singular_values: vec![2.0],
            next_singular_value: 0.5,
            residual: 1e-15,
            katz_residual: 2e-16,
            gap: 0.75,
            ambiguous: false,
            mode: EmbeddingMode::Dense,
            teams_shown: Some(2),
            team_scores: vec![0.25, 0.5],
            stage_us: [10, 20, 30],
        },
    };
    let pair = PairSimilarity {
        header: header(43),
        from: robot("r1"),
        to: robot("r2"),
        similarity: 0.75,
        shares: vec![(Modality::hierarchy(), 0.5), (Modality::spatial(), 0.25)],
        alpha: 0.5,
        method: PairMethod::Cached,
        residual: 2e-16,
    };
    let teams = Teams {
        header: header(44),
        embedding: revision(43),
        requested: 2,
        considered: vec![
            TeamCountScore { teams: 1, score: 0.25 },
            TeamCountScore { teams: 2, score: 0.5 },
        ],
        teams: vec![Team {
            id: team("t1"),
            members: vec![Member { robot: robot("r1"), margin: 0.75 }],
            leader: robot("r1"),
            centroid: vec![0.25, -0.5],
        }],
        unassigned: vec![robot("r2")],
        stale: vec![robot("r1")],
        inertia: 0.125,
        changes: vec![
            TeamChange::Split { from: team("t1"), into: team("t2") },
            TeamChange::Moved { robot: robot("r2"), from: Some(team("t1")), to: None },
        ],
        next_team: 3,
        limited: Some(Limited {
            optimal: false,
            gap: 0.125,
            conflict: Some("8 robots may only be in t1, which holds 6".to_owned()),
            prices: vec![0.375],
            skill_prices: vec![SkillPrices {
                skill: skill("medic"),
                robots: vec![robot("r1")],
                prices: vec![-0.125],
            }],
            jointly: vec![robot("r2")],
        }),
        needs: vec![TeamNeed {
            team: team("t1"),
            skill: skill("medic"),
            min: 1,
            max: Some(2),
            soft: false,
            have: 0,
        }],
        provisional: vec![robot("r1")],
        held: vec![HeldRobot { robot: robot("r1"), team: team("t1") }],
        remembered: RememberedTeams {
            last: vec![(robot("r9"), team("t9"))],
            ended: vec![(team("t9"), vec![robot("r9")])],
            newcomers_from: 4,
        },
    };
    let robot_team = teams.robot_team(&robot("r1")).unwrap();
    let report = |space, mean| SilhouetteReport {
        space,
        mean,
        method: SilhouetteMethod::Sampled,
        standard_error: 0.0078125,
        per_team: vec![(team("t1"), 0.5)],
        per_robot: vec![(robot("r1"), 0.5)],
        detail_method: SilhouetteMethod::SquaredExact,
    };
    let audit = Audit {
        header: header(45),
        teams: revision(44),
        embedding: revision(43),
        in_embedding: report(Space::Embedding, Some(0.5)),
        in_physical: report(Space::Physical, None),
        quality: Quality::Good,
        flapping: Flapping {
            returns_per_robot_minute: 1.5,
            robots: vec![RobotReturns { robot: robot("r1"), returns: 3 }],
        },
        graphs: Some(revision(42)),
        per_team: vec![TeamAudit {
            team: team("t1"),
            robots: 3,
            stale: 1,
            leader_stale: true,
            silhouette: Some(0.5),
            least: Some(LeastFitting { robot: robot("r1"), silhouette: -0.25 }),
            conductance: vec![Conductance { modality: Modality::hierarchy(), conductance: 0.125 }],
            radio: Some(Radio {
                parts: 2,
                reached_by_leader: 0,
                cut_robot_count: 1,
                cut_robots: vec![robot("r1")],
                bridges: 2,
                worst_cut: 0.5,
            }),
            heads: 1,
            only_head: Some(robot("r1")),
            spread: Some(Spread { rms_m: 2.5, largest_m: 4.0 }),
            skills: vec![SkillCover {
                skill: skill("medic"),
                robots: 3,
                needed: 1,
                spare: 2,
                lacking: 0,
            }],
        }],
        losses: vec![Loss {
            robot: robot("r1"),
            team: team("t1"),
            part_count: 2,
            parts: vec![5, 4],
            cut_off: 4,
            is_leader: true,
            is_only_head: false,
        }],
    };
    let event = |kind| {
        Message::Event(Event {
            header: header(46),
            source: ServiceName::Clusterer,
            severity: Severity::Warning,
            kind,
        })
    };
    let quarantined = EventKind::Quarantined {
        robot: Some(robot("r1")),
        key: "muster/v1/alpha/robot/r1/pose".to_owned(),
        reason: "x: must be finite".to_owned(),
        count: 2,
    };
    let refused = Refused {
        header: header(47),
        robot: robot("r1"),
        key: "muster/v1/alpha/robot/r1/poze".to_owned(),
        reason: "the stream \"poze\" is unknown".to_owned(),
        count: 2,
    };
    let status = ServiceStatus {
        fleet: fleet(),
        service: ServiceName::Ingest,
        instance: InstanceId::new("host-1").unwrap(),
        version: "0.1.0".to_owned(),
        started: Tick(NOW.0 - 60_000_000),
        now: NOW,
        standing: ReplicaState::Leading,
        revision: revision(42),
        state: "2 robots, 1 stale".to_owned(),
        counters: BTreeMap::from([("poses_accepted".to_owned(), 600)]),
        departed: vec![Departure { robot: robot("r7"), left: Tick(NOW.0 - 30_000_000) }],
    };
    let wish = StandingWish {
        operator: OperatorId::new("alice").unwrap(),
        id: WishId::new("p1").unwrap(),
        wish: Wish {
            kind: WishKind::Pin,
            robots: vec![robot("r1")],
            team: Some(team("t2")),
            expires: Some(1_795_209_990.5),
            note: Some("carries the relay".to_owned()),
        },
        state: WishState::Waiting,
        reason: Some("team t2 is not there".to_owned()),
    };
    vec![
        ("pose", from_robot("r1", pose)),
        ("links", from_robot("r1", links)),
        ("rank", from_robot("r2", rank)),
        ("relation", from_robot("r1", (Modality::new("thermal").unwrap(), relation))),
        ("graph", Message::Graph(Arc::new(graph))),
        ("roster", Message::Roster(Checked::new_unchecked(roster))),
        ("embedding", Message::Embedding(Checked::new_unchecked(embedding))),
        ("teams", Message::Teams { teams: Checked::new_unchecked(teams), mirror: false }),
        ("robot_team", Message::RobotTeam(robot_team)),
        ("refused", Message::Refused(Box::new(refused))),
        ("audit", Message::Audit(Arc::new(audit))),
        ("event", event(quarantined)),
        (
            "event_change",
            event(EventKind::TeamChanged(TeamChange::Merged {
                from: team("t2"),
                into: team("t1"),
            })),
        ),
        (
            "settings",
            Message::Settings(Box::new(AnnouncedSettings {
                header: header(44),
                service: ServiceName::Clusterer,
                settings: "{\"teams\":3}".to_owned(),
                changed: BTreeMap::from([("teams".to_owned(), Tick(NOW.0 - 7))]),
            })),
        ),
        (
            "claim",
            Message::LeaseRenewal(Box::new(LeaseRenewal {
                header: header(45),
                service: ServiceName::Embedder,
                instance: InstanceId::new("host-1").unwrap(),
            })),
        ),
        ("status", Message::Status(Box::new(status))),
        ("katz", Message::Katz(Box::new(pair))),
        ("why", Message::Why(Box::new(why()))),
        ("history", Message::History(Box::new(history()))),
        ("history_state", Message::HistoryState(Box::new(history_state()))),
        ("alerts", Message::Alerts(Arc::new(alerts()))),
        (
            "wishes",
            Message::Wishes(Checked::new_unchecked(WishList {
                header: header(48),
                wishes: vec![wish.clone()],
            })),
        ),
        ("skilled_rank", from_robot("r2", skilled_rank)),
        ("wish_report", Message::Wish(Box::new(WishReport { header: header(48), wish }))),
        ("command_outcome", Message::Outcome(Arc::new(outcome()))),
        ("proposal", Message::Proposal(Box::new(proposal()))),
    ]
}

fn proposal() -> ProposalReport {
    let asked = serde_json::json!({"teams": 2, "size": {"max": 4}, "without": ["r7"]});
    let teams = serde_json::json!({"teams": 3, "size": {"min": null, "max": null}});
    let serde_json::Value::Object(replaces) = teams else { unreachable!("it is an object") };
    let quality = |mean: f64| DivisionQuality {
        mean: Some(mean),
        least_team: Some(mean / 2.0),
        physical_mean: None,
    };
    let division = ProposedDivision {
        based_on: revision(42),
        replaces: BTreeMap::from([(ServiceName::Clusterer, replaces)]),
        embedded: true,
        teams: vec![ProposedTeam {
            id: team("t1"),
            members: vec![robot("r1"), robot("r2")],
            mean: Some(0.75),
            least: Some(0.5),
        }],
        unassigned: vec![robot("r7")],
        moves: vec![ProposedMove { robot: robot("r7"), from: Some(team("t2")), to: None }],
        proposed: quality(0.75),
        live: quality(0.5),
        change: quality(0.75).beyond(&quality(0.5)),
        live_teams: vec![LiveTeam { id: team("t1"), robots: 2, mean: Some(0.5), least: None }],
        conflict: None,
    };
    ProposalReport {
        header: header(50),
        proposal: Proposal {
            operator: OperatorId::new("alice").unwrap(),
            id: ProposalId::new("p1").unwrap(),
            state: ProposalState::Ready,
            asked: ProposalRequest::from_json(asked).unwrap(),
            ahead: 0,
            age_s: 2.5,
            forgotten_in_s: Some(57.5),
            division: Some(division),
        },
    }
}

fn outcome() -> CommandOutcome {
    CommandOutcome {
        header: header(49),
        service: ServiceName::Clusterer,
        operator: OperatorId::new("kim").unwrap(),
        id: CommandId::new("c1").unwrap(),
        expires: 1_800_000_000.5,
        based_on: Some(Revision { term: 3, epoch: 48 }),
        action: "{\"set\":{\"teams\":3}}".to_owned(),
        refused: None,
        answer: Some("{\"teams\":3}".to_owned()),
        may_be_repeated: false,
        changed: Some(SettingsChange { at: Tick(NOW.0 - 7), fields: "{\"teams\":3}".to_owned() }),
    }
}

fn history() -> HistoryAnswer {
    let audit = PastAudit {
        sequence: 41,
        at: Tick(NOW.0 - 20_000_000),
        division: revision(42),
        mean: Some(0.5),
        physical_mean: None,
        verdict: Quality::Good,
        per_team: vec![TeamMean { team: team("t1"), mean: 0.5 }],
    };
    let division = PastDivision {
        sequence: 40,
        at: Tick(NOW.0 - 30_000_000),
        revision: revision(42),
        requested: 2,
        teams: vec![PastTeam {
            id: team("t1"),
            members: vec![robot("r1"), robot("r2")],
            leader: Some(robot("r1")),
        }],
        unassigned: vec![robot("r3")],
        stale: vec![robot("r2")],
        audit: Some(audit),
        positions_at: Some(Tick(NOW.0 - 25_000_000)),
        positions: [(robot("r1"), [1.25, -30.0]), (robot("r2"), [0.0, 4.5])].into(),
    };
    HistoryAnswer {
        fleet: fleet(),
        instance: InstanceId::new("host-1").unwrap(),
        recorded_from: Some(Tick(NOW.0 - 60_000_000)),
        recorded_through: Some(NOW),
        before: None,
        rows: Rows::AsOf(Some(Box::new(division))),
    }
}

/// One of every kind of rows that a history answers, by name, but the division at a moment.
pub(crate) fn history_rows() -> Vec<(&'static str, Rows)> {
    let at = Tick(NOW.0 - 30_000_000);
    let division = DivisionRow {
        sequence: 40,
        at,
        revision: revision(42),
        requested: 2,
        teams: 2,
        robots: 3,
        changed: 1,
        snapshot: Some(SnapshotCause::Gap),
    };
    let place = PlaceRow {
        sequence: 40,
        at,
        team: Some(team("t1")),
        was: None,
        present: true,
        stale: false,
        snapshot: None,
    };
    let of_team = TeamRow {
        sequence: 40,
        at,
        leader: Some(robot("r1")),
        members: 2,
        came: vec![robot("r2")],
        went: vec![robot("r3")],
    };
    let event = EventRow {
        sequence: 41,
        at,
        source: ServiceName::Ingest,
        revision: revision(7),
        severity: Severity::Warning,
        event: "robot_left".to_owned(),
        detail: r#"{"robot":"r3"}"#.to_owned(),
    };
    let stay = StayRow {
        sequence: 3,
        robot: robot("r3"),
        joined: Some(Tick(NOW.0 - 60_000_000)),
        recorded: Tick(NOW.0 - 60_000_000),
        left: Some(at),
        last_seen: Some(Tick(at.0 - 10_000_000)),
        reason: Some(LeaveReason::Disconnected),
    };
    vec![
        ("divisions", Rows::Divisions(vec![division])),
        ("robot", Rows::Robot(vec![place])),
        ("team", Rows::Team(vec![of_team])),
        ("events", Rows::Events(vec![event])),
        ("robots", Rows::Robots(vec![stay])),
    ]
}

/// An answer of a history with these rows, and more behind them.
pub(crate) fn history_of(rows: Rows) -> Message {
    Message::History(Box::new(HistoryAnswer { rows, before: Some(40), ..history() }))
}

fn history_state() -> RecordingState {
    let coverage = Coverage {
        recorded_from: Some(Tick(NOW.0 - 60_000_000)),
        recorded_through: Some(NOW),
        sequence: 42,
        division: Some(revision(42)),
        audit: Some(revision(17)),
        events: vec![EventCoverage { source: ServiceName::Ingest, revision: revision(5) }],
        bytes: 4096,
    };
    RecordingState {
        fleet: fleet(),
        instance: InstanceId::new("host-1").unwrap(),
        coverage,
        lost: 3,
        degraded: Some("the disk is full".to_owned()),
    }
}

fn alerts() -> Alerts {
    let cut_off = Alert {
        id: 7,
        kind: AlertKind::CutOff,
        subject: AlertSubject::Team(team("t1")),
        raised: Tick(NOW.0 - 5_000_000),
        value: 2.0,
        threshold: 2.0,
        reason: "no link joins the 2 parts of t1; its leader reaches 1 of 3 robots".to_owned(),
        robots: vec![robot("r1")],
        acknowledged: Some(Acknowledgement {
            operator: OperatorId::new("kim").unwrap(),
            at: Tick(NOW.0 - 1_000_000),
        }),
    };
    let doubted = Alert {
        id: 8,
        kind: AlertKind::ModalityDoubted,
        subject: AlertSubject::Modality(Modality::spatial()),
        value: 0.25,
        threshold: 0.5,
        acknowledged: None,
        ..cut_off.clone()
    };
    Alerts { header: header(48), next_id: 9, folded: 3, open: vec![cut_off, doubted] }
}

/// One of every kind of event; the changes of a division with every kind of change.
pub(crate) fn event_kinds() -> Vec<EventKind> {
    let r1 = || robot("r1");
    let (t1, t2) = (team("t1"), team("t2"));
    let reason = || "alpha: must be below 1/rho".to_owned();
    let changes = [
        TeamChange::Born { team: t1.clone() },
        TeamChange::Died { team: t1.clone() },
        TeamChange::Split { from: t1.clone(), into: t2.clone() },
        TeamChange::Merged { from: t2, into: t1.clone() },
        TeamChange::Moved { robot: r1(), from: Some(t1), to: None },
    ];
    let mut kinds = vec![
        EventKind::Quarantined {
            robot: Some(r1()),
            key: "muster/v1/alpha/robot/r1/pose".to_owned(),
            reason: reason(),
            count: 2,
        },
        EventKind::RobotJoined { robot: r1() },
        EventKind::RobotStale { robot: r1() },
        EventKind::RobotRecovered { robot: r1() },
        EventKind::RobotLeft { robot: r1() },
        EventKind::FewerTeams { requested: 3, formed: 2, reason: reason() },
        EventKind::SettingsChanged { settings: "{\"teams\":3}".to_owned() },
        EventKind::JobFailed { reason: reason() },
        EventKind::QualityLow { mean: 0.25 },
        EventKind::QualityRecovered { mean: 0.5 },
        EventKind::ServiceStarted { term: 3 },
        EventKind::SettingDropped { field: "teams".to_owned() },
        EventKind::LinkRestored { outage_s: 2.5 },
        EventKind::Flapping { returns_per_robot_minute: 1.5, robots: vec![r1()] },
        EventKind::FlappingEnded { returns_per_robot_minute: 0.5 },
        EventKind::ModalityDoubted {
            modality: Modality::spatial(),
            trust: 0.25,
            robots: vec![r1()],
        },
        EventKind::ModalityTrusted { modality: Modality::spatial(), trust: 1.0 },
        EventKind::RobotsStale { count: 2, robots: vec![r1(), robot("r2")] },
        EventKind::RobotsRecovered { count: 2, robots: vec![r1(), robot("r2")] },
        EventKind::RobotsLeft { count: 2, robots: vec![r1(), robot("r2")] },
        EventKind::StateLost { reason: "term.json: cannot be read".to_owned() },
        EventKind::HistoryDegraded { reason: "the disk is full".to_owned() },
        EventKind::HistoryRecovered { lost: 3 },
        EventKind::HistoryDamaged { reason: "history.sqlite: malformed".to_owned() },
        EventKind::AlertRaised {
            alert: 7,
            kind: AlertKind::CutOff,
            team: Some(team("t1")),
            modality: None,
            value: 2.0,
            threshold: 2.0,
            reason: "no link joins the 2 parts of t1".to_owned(),
            robots: vec![r1()],
        },
        EventKind::AlertCleared {
            alert: 7,
            kind: AlertKind::CutOff,
            team: Some(team("t1")),
            modality: None,
            open_s: 12.5,
        },
        EventKind::AlertAcknowledged { alert: 7, operator: OperatorId::new("kim").unwrap() },
        EventKind::AlertsFolded { count: 3 },
        EventKind::Infeasible { reason: "8 robots may only be in t1, which holds 6".to_owned() },
        EventKind::FeasibleAgain { after_s: 2.5 },
        EventKind::WishChanged {
            operator: OperatorId::new("alice").unwrap(),
            id: WishId::new("p1").unwrap(),
            state: WishState::Active,
        },
        EventKind::Commanded {
            operator: OperatorId::new("kim").unwrap(),
            command: CommandId::new("c1").unwrap(),
            action: "{\"set\":{\"teams\":0}}".to_owned(),
            refused: Some(
                "{\"error\":\"teams: must be 1 or more\",\"field\":\"teams\"}".to_owned(),
            ),
        },
        EventKind::NeedFilled {
            team: team("t1"),
            skill: skill("medic"),
            robots: vec![r1()],
            reason: "r2 is silent".to_owned(),
        },
    ];
    kinds.extend(changes.map(EventKind::TeamChanged));
    kinds
}

fn why() -> Why {
    let reason = |name: &str, pulls: [f64; 2], price: f64, hysteresis: f64| {
        let names = [Modality::hierarchy(), Modality::spatial()];
        let pull = |(modality, pull)| ModalityPull { modality, pull };
        TeamReason {
            team: team(name),
            robots: 2,
            max: Some(2),
            min: 1,
            barred: name == "t3",
            score: pulls.iter().sum::<f64>() + 0.125 - 0.25,
            modalities: names.into_iter().zip(pulls).map(pull).collect(),
            itself: 0.125,
            spread: -0.25,
            rest: 0.0,
            price,
            hysteresis,
            total: 0.0,
            skill_price: price / 2.0,
        }
        .summed()
    };
    let reason = Reason {
        robot: robot("r7"),
        team: team("t1"),
        decided_by: DecidedBy::Relations,
        text: String::new(),
        division: revision(44),
        older_s: Some(0.5),
        provisional: true,
        held_from: Some(team("t2")),
        length_squared: 1.0,
        teams: vec![
            reason("t1", [0.5, 0.25], 0.0, 0.0625),
            reason("t2", [0.25, 0.75], 0.75, 0.0),
            reason("t3", [0.0, 0.125], 0.0, 0.0),
        ],
        wishes: vec![ReasonWish {
            operator: OperatorId::new("alice").unwrap(),
            id: WishId::new("p1").unwrap(),
            kind: WishKind::Ban,
            team: Some(team("t3")),
            granted: true,
        }],
        hysteresis: 0.0625,
        dwell_s: 0.5,
        conflict: None,
        skill: Some(skill("medic")),
        jointly: false,
        settings_assumed: true,
    };
    Why { header: header(43), reason: reason.decided() }
}
