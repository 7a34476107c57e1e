//! What the triplets of the previous frame do not lead to: a group that has become strong elsewhere.
//!
//! A residual cannot reveal it, and the search follows only what it starts with. A few more
//! directions are therefore kept from frame to frame, orthogonal to all known triplets. Each frame
//! advances them by one step of subspace iteration with SᵀS, in which a polynomial stands for the
//! inverses, so that they turn to the strongest of what is missing; one of them begins again at
//! random. Where something is known of the change, it is looked at directly: the rows that have
//! changed and their neighbours, on which a few products find what is strong there alone.
//!
//! Both end with the Rayleigh quotients of S on directions orthogonal to the known ones, which bound
//! the missing singular values from below: no estimate is involved.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::linalg::backend::small_symmetric::Symmetric;
use crate::linalg::block_vectors::{BlockView, CHUNK_ROWS, add_gram};
use crate::linalg::parallel::{Parts, Strided};
use crate::linalg::simd::dispatch;
use crate::linalg::vector::zeros;
use crate::svd::davidson::Workspace;
use crate::svd::operator::{KatzOperator, Orientation};

/// Directions that are kept: one register of them.
pub const PROBE_DIRECTIONS: usize = 8;

/// Shorthand of this file.
const WIDTH: usize = PROBE_DIRECTIONS;

/// Most nodes of a part of the graph that is looked at directly: a few neighbourhoods. It takes as
/// long as the update itself then.
pub(super) const MAX_LOCAL_NODES: usize = 128;

/// Steps of walks within such a part.
const LOCAL_STEPS: usize = 8;

/// Rounds of SᵀS within such a part.
const LOCAL_ROUNDS: usize = 3;

/// Squared length that must be left of a unit direction, orthogonal to the known ones: less is the
/// error of the known ones themselves.
const LEAST_NEW_PART: f64 = 0.05;

/// Known triplets: V and S V in rows of `width` values, and the combinations of their columns that
/// are orthonormal, width × width; none for the columns as they are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known<'a> {
    pub(super) right: &'a [f64],
    pub(super) image: &'a [f64],
    pub(super) width: usize,
    pub(super) rotation: Option<&'a [f64]>,
    /// Their values.
    pub(super) sigma: &'a [f64],
}

impl Known<'_> {
    /// No triplet.
    pub(super) const NONE: Self =
        Self { right: &[], image: &[], width: 0, rotation: None, sigma: &[] };
}

/// Directions outside of the known triplets.
#[derive(Debug, Default)]
pub(super) struct Probe {
    /// W, V and S V, n × [`PROBE_DIRECTIONS`], in the inner order.
    directions: Vec<f64>,
    space: Vec<f64>,
    image: Vec<f64>,
    /// Lower bounds of the missing singular values, descending.
    values: Vec<f64>,
    /// The first of them after the last step.
    strongest: f64,
    /// Steps so far.
    steps: u64,
    sums: Vec<f64>,
    small: Small,
    local: Local,
    symmetric: Symmetric,
}

#[derive(Debug, Default)]
struct Small {
    gram: Vec<f64>,
    energy: Vec<f64>,
    along: Vec<f64>,
    spread: Vec<f64>,
    change: Vec<f64>,
    other: Vec<f64>,
}

/// A part of the graph.
#[derive(Debug, Default)]
struct Local {
    nodes: Vec<u32>,
    /// Place of each node in `nodes`, plus one; 0 outside.
    places: Vec<u32>,
    /// Part in which a node was last visited.
    stamps: Vec<u32>,
    stamp: u32,
    /// W on the nodes, m × [`PROBE_DIRECTIONS`].
    w: Vec<f64>,
    term: Vec<f64>,
    next: Vec<f64>,
}

impl Probe {
    /// Discards everything.
    pub(super) fn forget(&mut self) {
        self.directions.clear();
        self.values.clear();
        self.steps = 0;
        self.strongest = 0.0;
    }

    /// Makes room for directions of `n` nodes next to `width` known ones.
    pub(super) fn reserve(&mut self, n: usize, width: usize) {
        let room = |block: &mut Vec<f64>, values: usize| {
            block.reserve(values.saturating_sub(block.len()));
        };
        for block in [&mut self.directions, &mut self.space, &mut self.image] {
            room(block, n * WIDTH);
        }
        room(&mut self.sums, Parts::new(n, 1).count() * (width * WIDTH).max(2 * WIDTH * WIDTH));
        let Small { gram, energy, along, spread, change, other } = &mut self.small;
        for block in [gram, energy, along, spread, change, other] {
            room(block, width.max(WIDTH) * WIDTH);
        }
        self.values.reserve(WIDTH);
        self.local.reserve(n);
    }

    /// Steps since the first directions were drawn.
    pub(super) fn steps(&self) -> u32 {
        u32::try_from(self.steps).unwrap_or(u32::MAX)
    }

    /// The largest of the values that the last step has found outside of the known triplets; 0 before
    /// it.
    pub(super) fn strongest(&self) -> f64 {
        self.strongest
    }

    /// Follows a new order or new nodes: the direction of each node is that of `old`.
    pub(super) fn rearrange(&mut self, nodes: usize, old: impl Fn(usize) -> Option<usize>) {
        if self.directions.is_empty() {
            return;
        }
        let mut moved = vec![0.0; nodes * WIDTH];
        for (i, row) in moved.chunks_exact_mut(WIDTH).enumerate() {
            if let Some(old) = old(i) {
                row.copy_from_slice(&self.directions[old * WIDTH..][..WIDTH]);
            }
        }
        self.directions = moved;
    }

    /// Rayleigh–Ritz on the directions, orthogonal to the `known` triplets. Returns lower bounds of
    /// the missing singular values, descending.
    pub(super) fn measure(
        &mut self,
        operator: &KatzOperator,
        parts: Parts,
        known: Known<'_>,
        seed: u64,
    ) -> &[f64] {
        let n = operator.nodes();
        self.values.clear();
        self.refresh(n, seed);
        for block in [&mut self.space, &mut self.image] {
            block.resize(n * WIDTH, 0.0);
        }
        let Self { directions, space, image, sums, small, .. } = self;
        let Known { right, image: known_image, width, rotation, .. } = known;
        let w = &*directions;
        let blocks = (Strided(space, WIDTH), Strided(image, WIDTH));
        parts.sum(sums, width * WIDTH, blocks, |rows, (space, image), sums| {
            operator.map_directions(rows.clone(), w, WIDTH, WIDTH, space.0, image.0, WIDTH, 0);
            let known = &right[rows.start * width..rows.end * width];
            let chunks = known.chunks(CHUNK_ROWS * width).zip(space.0.chunks(CHUNK_ROWS * WIDTH));
            for (known, space) in chunks {
                let known = BlockView::new(known, width, width);
                add_gram(known, BlockView::new(space, WIDTH, WIDTH), sums, WIDTH);
            }
        });
        // Coefficients of the known columns in the directions.
        small.along.clear();
        small.along.extend_from_slice(&sums[..width * WIDTH]);
        if let Some(rotation) = rotation {
            turn(rotation, width, &small.along, zeros(&mut small.spread, width * WIDTH), true);
            turn(rotation, width, &small.spread, zeros(&mut small.along, width * WIDTH), false);
        }
        let along = &small.along;
        let squares = WIDTH * WIDTH;
        let blocks = (
            Strided(&mut directions[..], WIDTH),
            Strided(&mut space[..], WIDTH),
            Strided(&mut image[..], WIDTH),
        );
        parts.sum(sums, 2 * squares, blocks, |rows, (w, space, image), sums| {
            let known = right.chunks_exact(width).zip(known_image.chunks_exact(width));
            let known = known.skip(rows.start).take(rows.len());
            dispatch(|| {
                let own =
                    w.0.chunks_exact_mut(WIDTH)
                        .zip(space.0.chunks_exact_mut(WIDTH).zip(image.0.chunks_exact_mut(WIDTH)));
                for ((w, (space, image)), (right, known)) in own.zip(known) {
                    for ((right, known), along) in
                        right.iter().zip(known).zip(along.chunks_exact(WIDTH))
                    {
                        for j in 0..WIDTH {
                            w[j] -= (right + known) * along[j];
                            space[j] -= right * along[j];
                            image[j] -= known * along[j];
                        }
                    }
                }
            });
            let (gram, energy) = sums.split_at_mut(squares);
            for (block, sums) in [(&*space.0, gram), (&*image.0, energy)] {
                for chunk in block.chunks(CHUNK_ROWS * WIDTH) {
                    let chunk = BlockView::new(chunk, WIDTH, WIDTH);
                    add_gram(chunk, chunk, sums, WIDTH);
                }
            }
        });
        small.gram.clear();
        small.gram.extend_from_slice(&sums[..squares]);
        small.energy.clear();
        small.energy.extend_from_slice(&sums[squares..2 * squares]);
        let lengths: [f64; WIDTH] = std::array::from_fn(|j| small.gram[j * WIDTH + j]);
        if !ritz(small, &mut self.symmetric, &lengths, 1e-8, &mut self.values) {
            self.directions.clear();
            self.strongest = 0.0;
            return &[];
        }
        self.strongest = self.values.first().copied().unwrap_or(0.0);
        let change = &small.change;
        for block in [&mut *directions, space, image] {
            parts.run(Strided(&mut block[..], WIDTH), |_, block| {
                for row in block.0.chunks_exact_mut(WIDTH) {
                    let mut sums = [0.0; WIDTH];
                    for (value, change) in row.iter().zip(change.chunks_exact(WIDTH)) {
                        for (sum, change) in sums.iter_mut().zip(change) {
                            *sum += value * change;
                        }
                    }
                    row.copy_from_slice(&sums);
                }
            });
        }
        &self.values
    }

    /// Column `j` of W, after [`Probe::measure`].
    pub(super) fn direction(&self, j: usize) -> impl Iterator<Item = f64> {
        self.directions.iter().skip(j).step_by(WIDTH).copied()
    }

    /// One step of subspace iteration with SᵀS, after [`Probe::measure`].
    pub(super) fn advance(&mut self, operator: &KatzOperator, parts: Parts, work: &mut Workspace) {
        let top = match self.values.first() {
            Some(top) if *top > 0.0 => *top,
            _ => return,
        };
        let (image, scale) = (&self.image, 1.0 / top);
        // V is no longer needed.
        parts.run(Strided(&mut self.space[..], WIDTH), |rows, out| {
            let backward = Orientation::Backward;
            operator.multiply(backward, rows, image, WIDTH, WIDTH, out.0, WIDTH, 0);
            out.0.iter_mut().for_each(|value| *value *= scale);
        });
        work.precondition(operator, parts, &self.space, &mut self.directions, WIDTH);
        self.steps += 1;
    }

    /// Draws missing directions at random, and one of the others: what is strong now may be
    /// orthogonal to all that was strong before.
    fn refresh(&mut self, n: usize, seed: u64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ self.steps.wrapping_mul(0x9e37_79b9));
        if self.directions.len() != n * WIDTH || self.directions.iter().any(|w| !w.is_finite()) {
            self.directions.clear();
            self.directions.resize_with(n * WIDTH, || rng.random::<f64>() - 0.5);
            return;
        }
        let renewed = (self.steps % WIDTH as u64) as usize;
        for row in self.directions.chunks_exact_mut(WIDTH) {
            row[renewed] = rng.random::<f64>() - 0.5;
        }
        let lost = self.values_lost();
        for row in self.directions.chunks_exact_mut(WIDTH) {
            for (value, lost) in row.iter_mut().zip(&lost) {
                if *lost {
                    *value = rng.random::<f64>() - 0.5;
                }
            }
        }
    }

    /// Which columns are zero.
    fn values_lost(&self) -> [bool; WIDTH] {
        let mut lost = [true; WIDTH];
        for row in self.directions.chunks_exact(WIDTH) {
            for (lost, value) in lost.iter_mut().zip(row) {
                *lost &= *value == 0.0;
            }
        }
        lost
    }

    /// What is strong on some `nodes` alone, orthogonal to the `known` triplets: a lower bound of a
    /// missing singular value. At most [`MAX_LOCAL_NODES`] of the nodes are looked at, the first
    /// ones. [`Probe::local_direction`] has the direction.
    pub(super) fn look_at(
        &mut self,
        operator: &KatzOperator,
        nodes: impl Iterator<Item = u32>,
        known: Known<'_>,
    ) -> f64 {
        self.local.assign(operator.nodes(), nodes);
        if self.local.nodes.is_empty() {
            return 0.0;
        }
        dispatch(|| self.look(operator, known))
    }

    /// The same for the nodes that were assigned, in a form that is compiled for the widest registers.
    #[inline(always)]
    fn look(&mut self, operator: &KatzOperator, known: Known<'_>) -> f64 {
        let Self { local, small, symmetric, values, .. } = self;
        let m = local.nodes.len();
        local.iterate(operator);
        let Known { right, image, width, rotation, sigma } = known;
        let squares = WIDTH * WIDTH;
        zeros(&mut small.gram, squares);
        zeros(&mut small.energy, squares);
        zeros(&mut small.along, width * WIDTH);
        zeros(&mut small.other, width * WIDTH);
        local.stamp += 1;
        for at in 0..m {
            let node = local.nodes[at];
            let (before, _) = operator.row(Orientation::Backward, node as usize);
            for &i in before.iter().chain([&node]) {
                let i = i as usize;
                if std::mem::replace(&mut local.stamps[i], local.stamp) == local.stamp {
                    continue;
                }
                let own_image = local.row_product(operator, Orientation::Forward, i, &local.w);
                let mut own = own_image.map(|value| -value);
                if let Some(at) = (local.places[i] as usize).checked_sub(1) {
                    for (own, w) in own.iter_mut().zip(&local.w[at * WIDTH..]) {
                        *own += w;
                    }
                }
                add_outer(&mut small.gram, &own, &own);
                add_outer(&mut small.energy, &own_image, &own_image);
                add_outer(&mut small.along, &right[i * width..][..width], &own);
                add_outer(&mut small.other, &image[i * width..][..width], &own_image);
            }
        }
        local.release();
        let lengths: [f64; WIDTH] = std::array::from_fn(|j| small.gram[j * WIDTH + j]);
        let Small { gram, energy, along, spread, other, .. } = &mut *small;
        if let Some(rotation) = rotation {
            for block in [&mut *along, other] {
                turn(rotation, width, block, zeros(spread, width * WIDTH), true);
                block.copy_from_slice(spread);
            }
        }
        // ‖S(V − V_k C)‖² with C = V_kᵀV, (S V_k)ᵀ S V_k = Σ² and D = (S V_k)ᵀ S V.
        let rows = along.chunks_exact(WIDTH).zip(other.chunks_exact(WIDTH));
        for ((along, other), sigma) in rows.zip(sigma) {
            let square = sigma * sigma;
            for i in 0..WIDTH {
                for j in 0..WIDTH {
                    gram[i * WIDTH + j] -= along[i] * along[j];
                    energy[i * WIDTH + j] -=
                        along[i] * other[j] + along[j] * other[i] - square * along[i] * along[j];
                }
            }
        }
        values.clear();
        if !ritz(small, symmetric, &lengths, LEAST_NEW_PART, values) {
            return 0.0;
        }
        self.values.first().copied().unwrap_or(0.0)
    }

    /// The W of the last [`Probe::look_at`]: its nodes and their values.
    pub(super) fn local_direction(&self) -> impl Iterator<Item = (usize, f64)> {
        let Self { local, small, .. } = self;
        local.nodes.iter().zip(local.w.chunks_exact(WIDTH)).map(|(node, w)| {
            let terms = w.iter().zip(small.change.chunks_exact(WIDTH));
            (*node as usize, terms.map(|(w, change)| w * change[0]).sum())
        })
    }
}

impl Local {
    fn assign(&mut self, n: usize, nodes: impl Iterator<Item = u32>) {
        self.reserve(n);
        self.nodes.clear();
        for node in nodes {
            if self.nodes.len() == MAX_LOCAL_NODES {
                break;
            }
            let place = &mut self.places[node as usize];
            if *place == 0 {
                self.nodes.push(node);
                *place = self.nodes.len() as u32;
            }
        }
    }

    fn reserve(&mut self, n: usize) {
        if self.places.len() == n {
            return;
        }
        self.places.clear();
        self.places.resize(n, 0);
        self.stamps.clear();
        self.stamps.resize(n, 0);
        self.stamp = 0;
        for block in [&mut self.w, &mut self.term, &mut self.next] {
            block.reserve(MAX_LOCAL_NODES * WIDTH);
        }
        self.nodes.reserve(MAX_LOCAL_NODES);
    }

    /// Marks no node as a part of it.
    fn release(&mut self) {
        for node in &self.nodes {
            self.places[*node as usize] = 0;
        }
    }

    /// Row `i` of αA or αAᵀ, within the part, times a block of it.
    #[inline(always)]
    fn row_product(
        &self,
        operator: &KatzOperator,
        orientation: Orientation,
        i: usize,
        block: &[f64],
    ) -> [f64; WIDTH] {
        let mut sums = [0.0; WIDTH];
        let (columns, weights) = operator.row(orientation, i);
        for (j, weight) in columns.iter().zip(weights) {
            if let Some(at) = (self.places[*j as usize] as usize).checked_sub(1) {
                for (sum, value) in sums.iter_mut().zip(&block[at * WIDTH..][..WIDTH]) {
                    *sum += weight * value;
                }
            }
        }
        sums
    }

    /// Leaves the W = V + S V of the strongest directions of the part in `w`.
    #[inline(always)]
    fn iterate(&mut self, operator: &KatzOperator) {
        let m = self.nodes.len();
        let mut rng = ChaCha8Rng::seed_from_u64(m as u64);
        self.w.clear();
        self.w.resize_with(m * WIDTH, || rng.random::<f64>() - 0.5);
        // Groups that are strong have no sign.
        self.w.iter_mut().step_by(WIDTH).for_each(|w| *w = 1.0);
        for round in 0..=LOCAL_ROUNDS {
            if round > 0 {
                self.walk(operator, Orientation::Forward);
                self.walk(operator, Orientation::Backward);
            }
            orthonormalise(&mut self.w);
        }
        // M⁻¹ V.
        self.next.clear();
        self.next.extend_from_slice(&self.w);
        self.walk(operator, Orientation::Forward);
        self.walked_plus_start();
    }

    /// `w` ← the walks of up to [`LOCAL_STEPS`] steps within the part, times `w`. Leaves the block
    /// before it in `next`.
    #[inline(always)]
    fn walk(&mut self, operator: &KatzOperator, orientation: Orientation) {
        let mut start = std::mem::take(&mut self.next);
        start.clear();
        start.extend_from_slice(&self.w);
        let mut term = std::mem::take(&mut self.term);
        term.clear();
        term.extend_from_slice(&self.w);
        self.w.fill(0.0);
        let mut image = [[0.0; WIDTH]; MAX_LOCAL_NODES];
        for _ in 0..LOCAL_STEPS {
            for (node, image) in self.nodes.iter().zip(&mut image) {
                *image = self.row_product(operator, orientation, *node as usize, &term);
            }
            let rows = term.chunks_exact_mut(WIDTH).zip(self.w.chunks_exact_mut(WIDTH));
            for ((term, sum), image) in rows.zip(&image) {
                term.copy_from_slice(image);
                for (sum, image) in sum.iter_mut().zip(image) {
                    *sum += image;
                }
            }
        }
        (self.next, self.term) = (start, term);
    }

    #[inline(always)]
    fn walked_plus_start(&mut self) {
        for (w, start) in self.w.iter_mut().zip(&self.next) {
            *w += start;
        }
    }
}

/// Makes the columns of `block` orthonormal, one after the other; dependent ones become zero.
#[inline(always)]
fn orthonormalise(block: &mut [f64]) {
    for j in 0..WIDTH {
        let square =
            |block: &[f64]| -> f64 { block.chunks_exact(WIDTH).map(|row| row[j] * row[j]).sum() };
        let before = square(block);
        for _ in 0..2 {
            for k in 0..j {
                let along: f64 = block.chunks_exact(WIDTH).map(|row| row[k] * row[j]).sum();
                block.chunks_exact_mut(WIDTH).for_each(|row| row[j] -= along * row[k]);
            }
        }
        let after = square(block);
        let scale = if after > 1e-20 * before { 1.0 / after.sqrt() } else { 0.0 };
        block.chunks_exact_mut(WIDTH).for_each(|row| row[j] *= scale);
    }
}

/// Adds the outer product of two rows, the second of [`PROBE_DIRECTIONS`] values, to `sums`.
#[inline(always)]
fn add_outer(sums: &mut [f64], left: &[f64], right: &[f64; WIDTH]) {
    for (sums, left) in sums.chunks_exact_mut(WIDTH).zip(left) {
        for (sum, right) in sums.iter_mut().zip(right) {
            *sum += left * right;
        }
    }
}

/// `out` = R `block`, or Rᵀ `block`, for the width × width matrix R; `out` is zero before.
fn turn(rotation: &[f64], width: usize, block: &[f64], out: &mut [f64], transposed: bool) {
    for (i, row) in rotation.chunks_exact(width).enumerate() {
        for (j, value) in row.iter().enumerate() {
            let (to, from) = if transposed { (j, i) } else { (i, j) };
            for c in 0..WIDTH {
                out[to * WIDTH + c] += value * block[from * WIDTH + c];
            }
        }
    }
}

/// Rayleigh–Ritz from the Gram matrices of V and S V: leaves the combinations of the columns in
/// `change`, those of what is left of unit directions above `least`, and their values. `lengths` are
/// the squares of the directions that count as 1. False when nothing is left.
fn ritz(
    small: &mut Small,
    symmetric: &mut Symmetric,
    lengths: &[f64; WIDTH],
    least: f64,
    values: &mut Vec<f64>,
) -> bool {
    let Small { gram, energy, change, other, .. } = small;
    let scales = lengths.map(|square| if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 });
    if !scales.iter().chain(&*energy).all(|value| value.is_finite()) {
        return false;
    }
    for matrix in [&mut *gram, energy] {
        for (row, scale) in matrix.chunks_exact_mut(WIDTH).zip(scales) {
            for (value, own) in row.iter_mut().zip(scales) {
                *value *= scale * own;
            }
        }
    }
    let Some((squares, vectors)) = symmetric.eigen(gram, WIDTH) else {
        return false;
    };
    let kept = squares.iter().filter(|square| **square > least).count();
    if kept == 0 {
        return false;
    }
    // Orthonormal combinations, and the energy of them.
    let whitened = zeros(other, WIDTH * WIDTH);
    for i in 0..WIDTH {
        for j in 0..kept {
            whitened[i * WIDTH + j] = vectors[i * WIDTH + j] / squares[j].sqrt();
        }
    }
    let mut inner = [[0.0; WIDTH]; WIDTH];
    let mut left = [[0.0; WIDTH]; WIDTH];
    for i in 0..WIDTH {
        for j in 0..WIDTH {
            left[i][j] = (0..WIDTH).map(|k| energy[i * WIDTH + k] * whitened[k * WIDTH + j]).sum();
        }
    }
    for i in 0..WIDTH {
        for j in 0..WIDTH {
            inner[i][j] = (0..WIDTH).map(|k| whitened[k * WIDTH + i] * left[k][j]).sum();
        }
    }
    let Some((squares, vectors)) = symmetric.eigen(inner.as_flattened(), WIDTH) else {
        return false;
    };
    values.clear();
    values.extend(squares.iter().take(kept).map(|square| square.max(0.0).sqrt()));
    let combined = zeros(change, WIDTH * WIDTH);
    for i in 0..WIDTH {
        for j in 0..kept {
            combined[i * WIDTH + j] = scales[i]
                * (0..WIDTH).map(|k| whitened[i * WIDTH + k] * vectors[k * WIDTH + j]).sum::<f64>();
        }
    }
    true
}
