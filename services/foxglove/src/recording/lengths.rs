//! Whether the lengths in a record fit into it: the parser of the library makes room for what a text says that it has, up to
//! 4 GB, before it looks whether that is there.

use mcap::records::op;

/// Whether every text of a record, and of its table of texts, ends within it. Of records that are not read, nothing is said.
pub(super) fn fit(opcode: u8, record: &[u8]) -> bool {
    let mut rest = Rest(record);
    let fits = match opcode {
        // The numbers of the channel and of its schema come first.
        op::CHANNEL => rest
            .skip(4)
            .and_then(|()| rest.text())
            .and_then(|()| rest.text())
            .and_then(|()| rest.table()),
        op::METADATA => rest.text().and_then(|()| rest.table()),
        // Two moments, the length of the records, and their checksum.
        op::CHUNK => rest.skip(28).and_then(|()| rest.text()),
        _ => Some(()),
    };
    fits.is_some()
}

/// What is not read yet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn skip(&mut self, length: usize) -> Option<()> {
        self.take(length).map(drop)
    }

    /// What has its length before it, in four bytes.
    fn counted(&mut self) -> Option<&'a [u8]> {
        let length = self.take(4)?.try_into().map(u32::from_le_bytes).ok()?;
        self.take(usize::try_from(length).ok()?)
    }

    fn text(&mut self) -> Option<()> {
        self.counted().map(drop)
    }

    /// Texts by texts.
    fn table(&mut self) -> Option<()> {
        let mut texts = Rest(self.counted()?);
        while !texts.0.is_empty() {
            texts.text()?;
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> Vec<u8> {
        [&u32::try_from(text.len()).unwrap().to_le_bytes()[..], text.as_bytes()].concat()
    }

    #[test]
    fn a_text_that_says_it_is_longer_than_its_record_does_not_fit() {
        let pairs = [text("fleet"), text("alpha")].concat();
        let table = text(std::str::from_utf8(&pairs).unwrap());
        let whole = [
            (op::CHANNEL, [&[0; 4][..], &text("/robot/r1/pose"), &text("json"), &table].concat()),
            (op::METADATA, [text("muster"), table].concat()),
            (op::CHUNK, [&[0; 28][..], &text("lz4")].concat()),
        ];
        for (opcode, record) in whole {
            assert!(fit(opcode, &record), "{opcode}");
            for length in 0..record.len() {
                assert!(!fit(opcode, &record[..length]), "{opcode} of {length} bytes");
            }
        }
        assert!(fit(op::MESSAGE, &[]), "it has no text");
    }
}
