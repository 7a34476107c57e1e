//! Means over seeds with their confidence intervals.

/// A mean with the half of its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Half of the interval; 0 for a single value.
    pub half: f64,
    /// Of how many values.
    pub count: usize,
}

/// Quantiles of Student's distribution at 97.5 % for 1, 2, … degrees of freedom; the normal distribution's
/// serves beyond them, where it is less than 2 % off.
const STUDENT: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056,
    2.052, 2.048, 2.045, 2.042,
];

/// The normal distribution's.
const NORMAL: f64 = 1.960;

impl Estimate {
    /// Of independent values, one for each seed. NaN for none.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
    pub fn of(values: &[f64]) -> Self {
        let count = values.len();
        let mean = values.iter().sum::<f64>() / count as f64;
        if count < 2 {
            return Self { mean, half: 0.0, count };
        }
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let deviation = (squares / (count - 1) as f64).sqrt();
        let quantile = STUDENT.get(count - 2).copied().unwrap_or(NORMAL);
        Self { mean, half: quantile * deviation / (count as f64).sqrt(), count }
    }

    /// In percent with two digits, as `97.46 ± 0.31`.
    #[must_use]
    pub fn percent(&self) -> String {
        format!("{:.2} ± {:.2}", 100.0 * self.mean, 100.0 * self.half)
    }

    /// With three digits.
    #[must_use]
    pub fn plain(&self) -> String {
        format!("{:.3} ± {:.3}", self.mean, self.half)
    }
}

/// Pearson's correlation of pairs; NaN where one side does not vary.
#[must_use]
pub fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let side = |pick: fn(&(f64, f64)) -> f64| {
        let values: Vec<f64> = pairs.iter().map(pick).collect();
        let mean = Estimate::of(&values).mean;
        values.into_iter().map(|value| value - mean).collect::<Vec<f64>>()
    };
    let (left, right) = (side(|pair| pair.0), side(|pair| pair.1));
    let dot = |l: &[f64], r: &[f64]| l.iter().zip(r).map(|(l, r)| l * r).sum::<f64>();
    dot(&left, &right) / (dot(&left, &left) * dot(&right, &right)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlation_is_that_of_lines_and_of_the_literature() {
        assert!((correlation(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]) - 1.0).abs() < 1e-15);
        assert!((correlation(&[(0.0, 1.0), (1.0, 0.0)]) + 1.0).abs() < 1e-15);
        assert_eq!(correlation(&[(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]), 0.0);
        assert!(correlation(&[(1.0, 1.0), (1.0, 2.0)]).is_nan());
    }

    #[test]
    fn the_interval_is_students() {
        let found = Estimate::of(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(found.mean, 3.0);
        // 2.776 · √2.5 / √5
        assert!((found.half - 1.963).abs() < 1e-3, "{found:?}");
        assert_eq!(Estimate::of(&[0.5]), Estimate { mean: 0.5, half: 0.0, count: 1 });
        assert!(Estimate::of(&[]).mean.is_nan());
        assert_eq!(Estimate::of(&[0.97; 3]).percent(), "97.00 ± 0.00");
    }
}
