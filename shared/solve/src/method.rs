//! The computation: graphs to Katz similarity to embedding to labels to silhouettes.

use muster_model::settings::{Alpha, Normalization, RowScaling, SingularValueScaling};
use muster_numeric::embedding::{Rows, Scale, embed};
use muster_numeric::fuse::{self, fuse};
use muster_numeric::katz;
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};

use super::decomposition::{Decomposition, Walks, of_katz};
use super::division::{Divided, divide};
use super::path::Path;
use super::problem::Problem;
use super::step::{Progress, Step};
use super::{SolveError, refuse};

/// How many robots a warning names.
const MOST_NAMED: usize = 10;

/// Everything that was found.
#[derive(Debug)]
pub(super) struct Solution {
    pub(super) radius: SpectralRadius,
    pub(super) alpha: f64,
    pub(super) decomposition: Decomposition,
    pub(super) embedding: DenseMatrix,
    /// Per robot, whether its row says nothing.
    pub(super) unseen: Vec<bool>,
    pub(super) divided: Divided,
    pub(super) warnings: Vec<String>,
}

/// Applies the method, and tells each step that it begins.
pub(super) fn solve(
    problem: &Problem,
    path: Path,
    progress: &mut Progress<'_>,
) -> Result<Solution, SolveError> {
    progress(Step::Fuse);
    let fused = fused(problem)?;
    progress(Step::SpectralRadius);
    let radius = spectral_radius(&fused, None);
    let alpha = match problem.alpha {
        Alpha::Value(alpha) => katz::Alpha::Value(alpha),
        Alpha::Fraction { fraction } => katz::Alpha::Fraction(fraction),
    };
    let alpha = alpha.resolve(&fused, &radius).or_else(of_katz)?;
    let walks = Walks { fused: &fused, alpha, radius: &radius };
    let decomposition = Decomposition::new(problem, walks, path, progress)?;
    drop(fused);

    let scale = match problem.scale {
        SingularValueScaling::None => Scale::None,
        SingularValueScaling::SqrtSigma => Scale::SqrtSigma,
        SingularValueScaling::InverseSqrtSigma => Scale::InverseSqrtSigma,
    };
    let rows = match problem.rows {
        RowScaling::None => Rows::None,
        RowScaling::Unit => Rows::Unit,
    };
    let svd = &decomposition.svd;
    let embedded = embed(svd, scale, rows);
    let mut warnings = Vec::new();
    if svd.ambiguous() {
        warnings.push(format!(
            "the singular values number {} and {} coincide: which directions make up the embedding \
             is arbitrary, and so may be the teams; choose another dimension than {}",
            svd.rank(),
            svd.rank() + 1,
            2 * svd.rank(),
        ));
    }
    if !decomposition.converged {
        warnings.push(format!(
            "the search for the singular vectors ended at a residual of {:.1e}, above the tolerance of \
             {:.1e}; for fewer robots --path dense is exact",
            decomposition.residual, problem.options.tolerance,
        ));
    }
    warnings.extend(unseen_warning(problem, &embedded.weak, svd.rank()));
    let divided = divide(problem, &embedded.x, &mut warnings, progress)?;
    Ok(Solution {
        radius,
        alpha,
        decomposition,
        embedding: embedded.x,
        unseen: embedded.weak,
        divided,
        warnings,
    })
}

/// A* of the file.
fn fused(problem: &Problem) -> Result<SparseMatrix, SolveError> {
    let graphs: Vec<_> = problem.graphs.iter().map(|graph| (&graph.matrix, graph.weight)).collect();
    let normalization = match problem.normalize {
        Normalization::None => fuse::Normalization::None,
        Normalization::Spectral => fuse::Normalization::Spectral,
    };
    fuse(&graphs, normalization)
        .or_else(|error| refuse("modalities", format!("the graphs cannot be added up: {error}")))
}

/// Names the robots whose rows say nothing.
fn unseen_warning(problem: &Problem, unseen: &[bool], rank: usize) -> Option<String> {
    let robots: Vec<&str> = problem
        .robots
        .iter()
        .zip(unseen)
        .filter(|(_, unseen)| **unseen)
        .map(|(robot, _)| robot.as_str())
        .collect();
    if robots.is_empty() {
        return None;
    }
    let named = robots.iter().take(MOST_NAMED).copied().collect::<Vec<_>>().join(", ");
    let more = match robots.len().saturating_sub(MOST_NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    Some(format!(
        "the embedding does not see {named}{more}: no edges, or a part of the fleet that is weaker \
         than the {rank} leading directions; their rows are zero and say nothing about their team, \
         which a larger dimension may change"
    ))
}
