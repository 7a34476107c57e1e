//! Arrays in files, low byte first, as numpy maps them.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use muster_numeric::matrix::SparseMatrix;
use muster_numeric::svd::RankKSvd;

fn write<const N: usize>(
    path: &Path,
    ending: &str,
    values: impl Iterator<Item = [u8; N]>,
) -> io::Result<()> {
    let mut file = BufWriter::new(File::create(path.with_extension(ending))?);
    for value in values {
        file.write_all(&value)?;
    }
    file.flush()
}

fn write_numbers<'a>(
    path: &Path,
    ending: &str,
    values: impl IntoIterator<Item = &'a f64>,
) -> io::Result<()> {
    write(path, ending, values.into_iter().map(|value| value.to_le_bytes()))
}

/// Compressed rows: `starts` and `columns` of four bytes, `weights` of eight.
pub(crate) fn write_graph(path: &Path, a: &SparseMatrix) -> io::Result<()> {
    let mut end = 0_u32;
    let ends = (0..a.nodes()).map(|i| {
        end += a.row(i).len() as u32;
        end.to_le_bytes()
    });
    write(path, "starts", std::iter::once(0_u32.to_le_bytes()).chain(ends))?;
    write(path, "columns", a.triplets().map(|(_, j, _)| (j as u32).to_le_bytes()))?;
    write(path, "weights", a.triplets().map(|(_, _, weight)| weight.to_le_bytes()))
}

/// `sigma`, and the vectors `u` and `v`, one row per node.
pub(crate) fn write_triplets(path: &Path, svd: &RankKSvd) -> io::Result<()> {
    write_numbers(path, "sigma", &svd.sigma)?;
    write_numbers(path, "u", svd.u.data())?;
    write_numbers(path, "v", svd.v.data())
}

/// All numbers of a file.
pub(crate) fn read_numbers(path: &Path) -> io::Result<Vec<f64>> {
    let bytes = std::fs::read(path)?;
    let (values, _) = bytes.as_chunks::<8>();
    Ok(values.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect())
}
