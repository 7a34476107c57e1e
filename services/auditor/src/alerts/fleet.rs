//! When an operator is alerted: of low quality, and of robots that change teams to and fro.

use muster_model::audit::Flapping;
use muster_model::event::EventKind;
use muster_model::settings::AuditorSettings;
use muster_model::time::{Tick, seconds};

/// Watches the mean silhouette: an alert needs quality that stays low, and lasts until it is
/// clearly better, so that a division on the border raises only one alert.
#[derive(Debug, Default)]
pub(crate) struct Alert {
    low_since: Option<Tick>,
    raised: bool,
}

impl Alert {
    /// Accepts the current mean silhouette; none where it is undefined, which counts as neither low nor
    /// high.
    pub(crate) fn observe(
        &mut self,
        now: Tick,
        mean: Option<f64>,
        settings: &AuditorSettings,
    ) -> Option<EventKind> {
        let low = mean.filter(|mean| *mean < settings.poor);
        self.low_since = low.map(|_| self.low_since.unwrap_or(now));
        if self.raised {
            let mean = mean.filter(|mean| *mean > settings.poor + settings.alert_clearance)?;
            self.raised = false;
            return Some(EventKind::QualityRecovered { mean });
        }
        let mean = low?;
        if now < self.due(settings)? {
            return None;
        }
        self.raised = true;
        Some(EventKind::QualityLow { mean })
    }

    /// An earlier leader has raised the alert, or has not.
    pub(crate) fn inherit(&mut self, raised: bool) {
        self.raised = raised;
    }

    /// When the alert will be raised if the quality stays as it is.
    pub(crate) fn due(&self, settings: &AuditorSettings) -> Option<Tick> {
        let since = self.low_since.filter(|_| !self.raised)?;
        Some(since.after(seconds(settings.alert_after_s)))
    }
}

/// Watches how often robots change teams to and fro. The window of the rate makes it slow enough that no
/// delay is needed.
#[derive(Debug, Default)]
pub(crate) struct FlappingAlert {
    raised: bool,
}

impl FlappingAlert {
    /// Accepts the current rate. One of a partial window ends no alert.
    pub(crate) fn observe(
        &mut self,
        flapping: Flapping,
        is_partial: bool,
        settings: &AuditorSettings,
    ) -> Option<EventKind> {
        let Flapping { returns_per_robot_minute, .. } = flapping;
        if self.raised {
            let release = settings.flapping * settings.alert_release;
            if returns_per_robot_minute > release || is_partial {
                return None;
            }
            self.raised = false;
            return Some(EventKind::FlappingEnded { returns_per_robot_minute });
        }
        if !flapping.is_above(settings.flapping) {
            return None;
        }
        self.raised = true;
        let robots = flapping.robots.into_iter().map(|entry| entry.robot).collect();
        Some(EventKind::Flapping { returns_per_robot_minute, robots })
    }

    /// An earlier leader has raised the alert, or has not.
    pub(crate) fn inherit(&mut self, raised: bool) {
        self.raised = raised;
    }

    /// Whether the alert stands, so that its end is to be watched for.
    pub(crate) fn is_raised(&self) -> bool {
        self.raised
    }
}

#[cfg(test)]
mod tests {
    use muster_model::audit::RobotReturns;
    use muster_model::id::RobotId;

    use super::*;

    fn settings() -> AuditorSettings {
        AuditorSettings {
            good: 0.5,
            poor: 0.25,
            alert_after_s: 3.0,
            alert_clearance: 0.05,
            flapping: 0.05,
            ..AuditorSettings::default()
        }
    }

    /// What is reported at each second for a series of means.
    fn reported(means: &[Option<f64>]) -> String {
        let mut alert = Alert::default();
        let mut at = Tick(0);
        let mut reported = String::new();
        for mean in means {
            reported.push(match alert.observe(at, *mean, &settings()) {
                Some(EventKind::QualityLow { .. }) => '!',
                Some(EventKind::QualityRecovered { .. }) => 'o',
                Some(_) => '?',
                None => '.',
            });
            at = at.after(seconds(1.0));
        }
        reported
    }

    #[test]
    fn an_alert_needs_quality_that_stays_low() {
        let (low, high) = (Some(0.1), Some(0.4));
        assert_eq!(reported(&[low, low, low, low, low, low]), "...!..");
        assert_eq!(reported(&[low, low, high, low, low, low, low]), "......!");
        assert_eq!(reported(&[low, low, None, low, low, low, low]), "......!");
        assert_eq!(reported(&[Some(0.25); 9]), ".........");
    }

    #[test]
    fn it_ends_once_the_quality_is_clearly_better() {
        let (low, border, high) = (Some(0.1), Some(0.28), Some(0.31));
        assert_eq!(reported(&[low, low, low, low, border, low, border, high, low]), "...!...o.");
        assert_eq!(reported(&[low, low, low, low, None, None, high, high]), "...!..o.");
        assert_eq!(reported(&[low, low, low, low, high, low, low, low, low]), "...!o...!");
    }

    #[test]
    fn an_alert_without_delay_is_raised_at_once() {
        let settings = AuditorSettings { alert_after_s: 0.0, ..settings() };
        let mut alert = Alert::default();
        let reported = alert.observe(Tick(7), Some(-0.5), &settings);
        assert_eq!(reported, Some(EventKind::QualityLow { mean: -0.5 }));
        assert_eq!(alert.due(&settings), None);
    }

    /// What is reported of a series of rates, each with the returns of its worst robot.
    fn flapping_reported(rates: &[(f64, u32)], settings: &AuditorSettings) -> String {
        let mut alert = FlappingAlert::default();
        let report = |(rate, returns): &(f64, u32)| {
            let robot = RobotId::new("r").unwrap();
            let robots = vec![RobotReturns { robot, returns: *returns }];
            let flapping = Flapping { returns_per_robot_minute: *rate, robots };
            match alert.observe(flapping, false, settings) {
                Some(EventKind::Flapping { robots, .. }) if robots.len() == 1 => '!',
                Some(EventKind::FlappingEnded { .. }) => 'o',
                Some(_) => '?',
                None => '.',
            }
        };
        rates.iter().map(report).collect()
    }

    #[test]
    fn robots_that_go_to_and_fro_raise_one_alert_until_half_of_the_threshold() {
        let settings = settings();
        let reported = |rates: &[(f64, u32)]| flapping_reported(rates, &settings);
        assert_eq!(reported(&[(0.0, 0), (0.05, 2), (0.06, 2), (0.9, 9)]), "..!.");
        assert_eq!(reported(&[(0.06, 2), (0.04, 2), (0.06, 2), (0.025, 1), (0.06, 2)]), "!..o!");
        // One robot that walks back once in a small fleet.
        assert_eq!(reported(&[(0.5, 1), (0.25, 1), (0.5, 2)]), "..!");
    }

    #[test]
    fn an_alert_of_flapping_without_a_threshold_ends_with_the_last_return() {
        let settings = AuditorSettings { flapping: 0.0, ..settings() };
        assert_eq!(
            flapping_reported(&[(0.0, 0), (0.01, 2), (0.01, 1), (0.0, 0)], &settings),
            ".!.o"
        );
    }
}
