//! The only modules that talk to the linear algebra library (faer).
//!
//! The library panics on wrong shapes, returns NaN for singular systems and may fail to converge
//! without a reason. The functions here take checked matrices and return `None` when the result
//! is not usable. Parallelism is passed explicitly: the library's default is a process-wide pool
//! that costs more than it gains at the sizes of this crate.

pub(crate) mod dense;
pub(crate) mod small_lu;
pub(crate) mod small_symmetric;
pub(crate) mod sparse_order;
