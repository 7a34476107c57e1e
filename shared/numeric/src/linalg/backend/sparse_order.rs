//! The order of elimination of a sparse matrix.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

/// The nodes of a graph in the order of the approximate minimum degree, for the pattern of A + Aᵀ.
/// `columns` gives the columns of each row of A, ascending. `None` when the library refuses it.
pub(crate) fn least_degree_order<'a>(
    n: usize,
    columns: impl Fn(usize) -> &'a [u32],
) -> Option<Vec<u32>> {
    let mut starts = vec![0_u32];
    let mut entries = Vec::new();
    for i in 0..n {
        entries.extend_from_slice(columns(i));
        starts.push(u32::try_from(entries.len()).ok()?);
    }
    let pattern = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &entries);
    let (mut order, mut place) = (vec![0_u32; n], vec![0_u32; n]);
    let mut memory = MemBuffer::new(amd::order_scratch::<u32>(n, entries.len()));
    let control = amd::Control::default();
    amd::order(&mut order, &mut place, pattern, control, MemStack::new(&mut memory)).ok()?;
    Some(order)
}
