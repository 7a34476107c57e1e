//! Buffers of numbers that begin where a cache line begins.
//!
//! A register of 64 bytes that lies across two lines costs two accesses, and so does every register
//! of a block whose rows are whole lines but which begins within one.

use std::ops::{Deref, DerefMut};

/// Bytes of a cache line.
const LINE: usize = 64;

/// Numbers from the start of a cache line on, kept for reuse.
#[derive(Debug, Default)]
pub(crate) struct Aligned<T> {
    data: Vec<T>,
    start: usize,
    len: usize,
}

impl<T: Copy + Default> Aligned<T> {
    /// Makes room for `len` numbers. They are zero where the length changes, and stay otherwise.
    pub(crate) fn resize(&mut self, len: usize) {
        if self.len == len {
            return;
        }
        let spare = LINE / size_of::<T>();
        if self.data.capacity() < len + spare {
            // The old numbers are not kept, so that they need not be there at the same time. New
            // memory comes as zeros, which nobody writes before they are used.
            self.data = Vec::new();
            self.data = vec![T::default(); len + spare];
        } else {
            self.data.clear();
            self.data.resize(len + spare, T::default());
        }
        // The address need not tell how far off the next line is; any start will do then.
        let off = self.data.as_ptr().align_offset(LINE);
        self.start = if off <= spare { off } else { 0 };
        self.len = len;
    }
}

impl<T> Deref for Aligned<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.data[self.start..self.start + self.len]
    }
}

impl<T> DerefMut for Aligned<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.data[self.start..self.start + self.len]
    }
}
