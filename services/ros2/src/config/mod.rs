//! The file that says which topics are read and written: [`File`] as it is written, [`Setup`] checked.

mod check;
mod file;
mod setup;
mod sources;

pub use self::file::{
    Axes, DatumFile, DialectName, File, FramesFile, LinksFile, PoseFields, PoseFile, PublishFile,
    RankFile, Unit,
};
pub use self::setup::{Content, PoseForm, PublishTopics, Setup, Source};

/// Most domains of one bridge.
pub const MAX_DOMAINS: usize = 16;

/// Most topics of each kind.
pub const MAX_TOPICS: usize = 32;

/// How often the newest of each robot is put at most, per second: as often as `ingest` makes frames at most.
pub const MAX_RATE_HZ: f64 = 50.0;

/// A field of the file that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct ConfigError {
    /// The field.
    pub field: String,
    /// What is wrong, and what would be right.
    pub problem: String,
}

fn wrong(field: impl Into<String>, problem: impl ToString) -> ConfigError {
    ConfigError { field: field.into(), problem: problem.to_string() }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn check(text: &str) -> Result<Setup, String> {
        let file: File = toml::from_str(text).map_err(|error| error.to_string())?;
        file.check().map_err(|error| error.to_string())
    }

    #[test]
    fn the_defaults_are_valid_and_written_as_they_are_read() {
        let setup = File::default().check().unwrap();
        assert_eq!(setup.sources.len(), 3);
        assert_eq!(setup.prefix, None, "each robot has a topic of its own");
        let text = toml::to_string(&File::default()).unwrap();
        assert_eq!(toml::from_str::<File>(&text).unwrap(), File::default());
        assert_eq!(toml::from_str::<File>("").unwrap(), File::default());
    }

    #[test]
    fn the_shipped_file_is_the_built_in_one_and_the_document_s_is_accepted() {
        let shipped = include_str!("../../../../deploy/ros2/topics.toml");
        assert_eq!(toml::from_str::<File>(shipped).unwrap(), File::default());
        let (_, document) = include_str!("../../README.md").split_once("```toml\n").unwrap();
        let setup = check(document.split("```").next().unwrap()).unwrap();
        assert_eq!(setup.sources.len(), 2 + 3 + 1 + 1);
    }

    #[test]
    fn every_kind_of_source_is_accepted() {
        let text = r#"
            domains = [0, 7]
            rate_hz = 20.0
            [frames]
            tf = "/tf"
            tf_static = "/tf_static"
            [[pose]]
            topic = "/{robot}/fix"
            type = "sensor_msgs/msg/NavSatFix"
            datum = { latitude = 48.0, longitude = 11.0 }
            [[pose]]
            topic = "/{robot}/fmu/out/vehicle_local_position"
            type = "px4_msgs/msg/VehicleLocalPosition"
            definition = "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\nfloat32 heading"
            frame = "map"
            axes = "north_east_down"
            fields = { x = "x", y = "y", z = "z", heading = "heading" }
            [[links]]
            topic = "/{robot}/neighbours"
            type = "own_msgs/msg/Links"
            definition = """
            Link[] links
            ================================================================================
            MSG: own_msgs/Link
            string peer
            float32 rssi
            """
            list = "links"
            peer = "peer"
            quality = "rssi"
            unit = "dbm"
            [[rank]]
            topic = "/{robot}/superior"
            type = "std_msgs/msg/String"
            superior = "data"
            [ranks]
            r1 = ""
            r2 = "r1"
            [publish]
            markers = ""
        "#;
        let setup = check(text).unwrap();
        assert_eq!(setup.sources.len(), 6);
        assert_eq!(setup.prefix.as_deref(), Some("{robot}/"));
        assert!(setup.publish.markers.is_none() && setup.publish.teams.is_some());
        assert_eq!(setup.every, Duration::from_millis(50));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_field() {
        const FIX: &str =
            "type = \"sensor_msgs/NavSatFix\"\ndatum = { latitude = 1.0, longitude = 1.0 }";
        let pose = |rest: &str| format!("[[pose]]\ntopic = \"/{{robot}}/p\"\n{rest}");
        for (text, expected) in [
            ("domain = 0", "unknown field `domain`"),
            ("domains = []", "domains: name from 1"),
            ("domains = [233]", "domains: 233 is none"),
            ("domains = [0, 7, 0]", "domains: 0 is named twice; name it once"),
            ("rate_hz = 0.0", "rate_hz: "),
            ("rate_hz = nan", "rate_hz: "),
            ("world = \"/\"", "world: "),
            ("namespace = \"/site\"", "namespace: rmw_zenoh has none"),
            ("frames.tf = \"/tf\"", "frames.tf_static: "),
            ("frames = { tf = \"/tf\", tf_static = \"/s\", prefix = \"x\" }", "frames.prefix: "),
            (
                "frames = { tf = \"/{robot}/tf\", tf_static = \"{robot}/tf/\" }",
                "frames.tf_static: is the topic of frames.tf; name another one",
            ),
            ("frames.max_age_s = 0.0", "frames.max_age_s: "),
            ("ranks = { r1 = \"r1\" }", "ranks.r1: a robot is not its own"),
            ("publish.team = \"/team\"", "publish.team: must contain {robot}"),
            (
                "publish.markers = \"muster/teams\"",
                "publish.markers: is the topic of publish.teams; name another one",
            ),
            (
                "publish = { teams = \"\", typed_teams = \"/a\", diagnostics = \"/a\" }",
                "publish.diagnostics: is the topic of publish.typed_teams; name another one",
            ),
            (
                "publish.team = \"/{robot}/teams\"",
                "publish.teams: is the topic of publish.team for a robot muster; name another one",
            ),
            (&pose("type = \"nav_msgs/Path\""), "pose[0].type: nav_msgs/msg/Path is not defined"),
            (&pose("type = \"sensor_msgs/NavSatFix\""), "pose[0].datum: name the place"),
            (&pose("type = \"std_msgs/String\""), "pose[0].fields: say where"),
            (
                &pose("type = \"geometry_msgs/Point\"\nfields = { x = \"x\", y = \"u\" }"),
                "pose[0].fields.y: geometry_msgs/msg/Point has no field u; it has x, y, z",
            ),
            (
                &pose("type = \"geometry_msgs/Point\"\nfields = { x = \"x\", y = \"y\" }"),
                "pose[0].frame: name the frame",
            ),
            (
                "[[pose]]\ntopic = \"/odom\"\ntype = \"nav_msgs/Odometry\"",
                "pose[0].topic: must contain",
            ),
            (&pose(&format!("{FIX}\nframe = \"map\"")), "pose[0].frame: a satellite fix has none"),
            (
                &pose(&format!("{FIX}\naxes = \"north_east_down\"")),
                "pose[0].axes: a satellite fix has none",
            ),
            (
                "dialect = \"ros2dds\"\n[[pose]]\ntopic = \"/{robot}\"\ntype = \"nav_msgs/Odometry\"",
                "pose[0].topic: where the first chunk of a pattern has wildcards",
            ),
            (
                "dialect = \"ros2dds\"\nframes = { tf = \"/muster/tf\", tf_static = \"/tf_static\" }",
                "frames.tf: keys under muster/",
            ),
        ] {
            let problem = check(text).unwrap_err();
            assert!(problem.contains(expected), "{text}: {problem}");
        }
    }
}
