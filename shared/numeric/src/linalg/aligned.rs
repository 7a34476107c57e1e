//! Buffers that start at a cache line.
//!
//! A register of 64 bytes that crosses two lines costs two accesses. So does every register of a
//! block whose rows are whole lines but which starts within a line.

use std::ops::{Deref, DerefMut};

/// Bytes of a cache line.
const LINE_BYTES: usize = 64;

/// Numbers from the start of a cache line on. The memory is reused.
#[derive(Debug, Default)]
pub(crate) struct Aligned<T> {
    data: Vec<T>,
    start: usize,
    len: usize,
}

impl<T: Copy + Default> Aligned<T> {
    /// Sets the length. Where it changes, all numbers become zero; otherwise they stay.
    pub(crate) fn resize(&mut self, len: usize) {
        if self.len == len {
            return;
        }
        let padding = LINE_BYTES / size_of::<T>();
        if self.data.capacity() < len + padding {
            // Free the old memory first, so that both never exist at once. The system zeroes new
            // memory lazily.
            self.data = Vec::new();
            self.data = vec![T::default(); len + padding];
        } else {
            self.data.clear();
            self.data.resize(len + padding, T::default());
        }
        // `align_offset` may give up; any start is correct then.
        let off = self.data.as_ptr().align_offset(LINE_BYTES);
        self.start = if off <= padding { off } else { 0 };
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
