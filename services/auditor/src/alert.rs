//! When an operator is alerted of low quality.

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

    /// When the alert will be raised if the quality stays as it is.
    pub(crate) fn due(&self, settings: &AuditorSettings) -> Option<Tick> {
        let since = self.low_since.filter(|_| !self.raised)?;
        Some(since.after(seconds(settings.alert_after_s)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> AuditorSettings {
        AuditorSettings { good: 0.5, poor: 0.25, alert_after_s: 3.0, alert_clearance: 0.05 }
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
}
