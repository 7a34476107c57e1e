//! Connectivity: link reports to edges from senders to receivers.

use muster_model::observation::ObservationError;
use muster_model::settings::{ConnectivitySettings, LinkUnit};

use crate::edge::{Edge, EdgeError, checked_edges};

/// The weight of a reported link, from 0 (no link) to 1.
///
/// Qualities and delivery ratios are taken as they are; signal strengths in dBm are mapped linearly
/// from the floor (0) to the ceiling (1) of the settings and held within these bounds.
///
/// # Errors
/// Names `links.quality` and its unit if the value cannot be of that unit.
pub fn link_weight(settings: &ConnectivitySettings, quality: f64) -> Result<f64, ObservationError> {
    let share = |what: &str| {
        if (0.0..=1.0).contains(&quality) {
            Ok(quality)
        } else {
            refuse(format!("must be a {what} from 0 to 1, is {quality}"))
        }
    };
    match settings.unit {
        LinkUnit::Quality => share("quality"),
        LinkUnit::DeliveryRatio => share("delivery ratio"),
        LinkUnit::RssiDbm if quality.is_finite() => Ok(signal_weight(settings, quality)),
        LinkUnit::RssiDbm => {
            refuse(format!("must be a signal strength as a finite number of dBm, is {quality}"))
        }
    }
}

/// The weight of a link of a signal strength in dBm, whatever the unit of the settings.
#[must_use]
pub fn signal_weight(settings: &ConnectivitySettings, dbm: f64) -> f64 {
    // Checked settings have a span of at least 1 dB; the bound keeps any others from 0/0.
    let span = (settings.rssi_ceiling_dbm - settings.rssi_floor_dbm).max(f64::MIN_POSITIVE);
    ((dbm - settings.rssi_floor_dbm) / span).clamp(0.0, 1.0)
}

fn refuse<T>(problem: String) -> Result<T, ObservationError> {
    Err(ObservationError { field: "links.quality", problem })
}

/// One edge from each sender to each robot that receives it.
///
/// Each report is the receiver, and its senders with the weight of each link (0 to 1, see
/// [`link_weight`]). Links of weight 0 are dropped. A single report may be given to check it alone.
///
/// # Errors
/// Names the first robot that receives itself, the first link of a weight below 0 or above 1, or that
/// is reported twice.
pub fn connectivity_edges<'a>(
    reports: impl IntoIterator<Item = (u32, &'a [(u32, f64)])>,
) -> Result<Vec<Edge>, EdgeError> {
    let edges = reports.into_iter().flat_map(|(receiver, links)| {
        links.iter().map(move |&(peer, weight)| (peer, receiver, weight))
    });
    checked_edges(edges, 1.0)
}

#[cfg(test)]
mod tests {
    use muster_model::settings::IngestSettings;
    use proptest::prelude::*;

    use super::*;

    fn settings(unit: LinkUnit) -> ConnectivitySettings {
        ConnectivitySettings { unit, ..IngestSettings::default().connectivity }
    }

    #[test]
    fn shares_are_taken_as_they_are() {
        for (unit, name) in
            [(LinkUnit::Quality, "quality"), (LinkUnit::DeliveryRatio, "delivery ratio")]
        {
            for good in [0.0, 0.3, 1.0] {
                assert_eq!(link_weight(&settings(unit), good), Ok(good));
            }
            for bad in [-0.1, 1.1, -60.0, f64::NAN, f64::INFINITY] {
                let error = link_weight(&settings(unit), bad).unwrap_err();
                assert_eq!(error.field, "links.quality");
                assert!(error.problem.contains(name), "{error}");
            }
        }
    }

    #[test]
    fn signal_strength_is_mapped_from_floor_to_ceiling() {
        let settings = settings(LinkUnit::RssiDbm);
        let pairs = [(-200.0, 0.0), (-90.0, 0.0), (-65.0, 0.5), (-40.0, 1.0), (1e308, 1.0)];
        for (dbm, weight) in pairs {
            assert_eq!(link_weight(&settings, dbm), Ok(weight), "{dbm} dBm");
        }
        let error = link_weight(&settings, f64::NAN).unwrap_err();
        assert!(error.to_string().contains("links.quality") && error.to_string().contains("dBm"));
    }

    #[test]
    fn a_floor_at_the_ceiling_is_a_step() {
        let mut settings = settings(LinkUnit::RssiDbm);
        settings.rssi_ceiling_dbm = settings.rssi_floor_dbm;
        assert_eq!(link_weight(&settings, -90.0), Ok(0.0));
        assert_eq!(link_weight(&settings, -89.0), Ok(1.0));
    }

    #[test]
    fn edges_run_to_the_receiver() {
        let reports: [(u32, &[(u32, f64)]); 3] =
            [(1, &[(2, 0.5), (0, 0.25)]), (0, &[(1, 1.0), (2, 0.0)]), (2, &[])];
        assert_eq!(connectivity_edges(reports), Ok(vec![(0, 1, 0.25), (1, 0, 1.0), (2, 1, 0.5)]));
    }

    #[test]
    fn bad_reports_are_refused() {
        let own: [(u32, &[(u32, f64)]); 1] = [(1, &[(1, 0.5)])];
        assert_eq!(connectivity_edges(own), Err(EdgeError::SelfRelation { robot: 1 }));
        let twice: [(u32, &[(u32, f64)]); 1] = [(1, &[(0, 0.5), (0, 0.6)])];
        assert!(matches!(connectivity_edges(twice), Err(EdgeError::Twice { .. })));
        let strong: [(u32, &[(u32, f64)]); 1] = [(1, &[(0, 1.5)])];
        assert!(matches!(connectivity_edges(strong), Err(EdgeError::Weight { .. })));
    }

    proptest! {
        #[test]
        fn any_signal_strength_has_a_weight_of_zero_to_one_that_grows_with_it(
            low in -1e3..1e3f64, more in 0.0..1e3f64,
        ) {
            let settings = settings(LinkUnit::RssiDbm);
            let (weak, strong) = (link_weight(&settings, low)?, link_weight(&settings, low + more)?);
            prop_assert!((0.0..=1.0).contains(&weak) && weak <= strong && strong <= 1.0);
        }
    }
}
