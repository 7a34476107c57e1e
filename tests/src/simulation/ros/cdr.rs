//! Messages of ROS as a robot has them in its own memory, and their bytes: written by hand after the rules of XCDR1, so
//! that nothing of it is shared with what reads them.

/// How a text of ROS comes in bytes: what stands before a message, in each order of bytes.
const HEAD: usize = 4;

/// Bytes of one message.
#[derive(Debug, Clone)]
pub(crate) struct Writer {
    bytes: Vec<u8>,
    is_big: bool,
}

impl Writer {
    /// A message without fields, in one of the two orders of bytes.
    pub(crate) fn new(is_big: bool) -> Self {
        Self { bytes: vec![0, u8::from(!is_big), 0, 0], is_big }
    }

    /// Every number begins at a multiple of its own size, counted from behind the head.
    fn align(&mut self, size: usize) {
        while !(self.bytes.len() - HEAD).is_multiple_of(size) {
            self.bytes.push(0);
        }
    }

    fn put<const N: usize>(&mut self, little: [u8; N]) {
        self.align(N);
        let mut bytes = little;
        if self.is_big {
            bytes.reverse();
        }
        self.bytes.extend(bytes);
    }

    pub(crate) fn long(&mut self, number: u32) {
        self.put(number.to_le_bytes());
    }

    pub(crate) fn double(&mut self, number: f64) {
        self.put(number.to_le_bytes());
    }

    pub(crate) fn doubles(&mut self, numbers: &[f64]) {
        numbers.iter().for_each(|number| self.double(*number));
    }

    /// A text has its length, with the zero that ends it, before it.
    pub(crate) fn text(&mut self, text: &str) {
        self.long(u32::try_from(text.len() + 1).unwrap_or(u32::MAX));
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
    }

    /// The head of a message: its time and its frame.
    pub(crate) fn header(&mut self, micros: u64, frame: &str) {
        self.long(u32::try_from(micros / 1_000_000).unwrap_or(u32::MAX));
        self.long(u32::try_from(micros % 1_000_000 * 1000).unwrap_or_default());
        self.text(frame);
    }

    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }
}

/// The one text of a `std_msgs/String` in little endian.
pub(crate) fn read_text(bytes: &[u8]) -> Option<&str> {
    let rest = bytes.strip_prefix(&[0, 1, 0, 0])?;
    let (length, text) = rest.split_at_checked(4)?;
    let length = u32::from_le_bytes(length.try_into().ok()?);
    let text = text.get(..usize::try_from(length).ok()?)?;
    std::str::from_utf8(text.strip_suffix(&[0])?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_at_multiples_of_their_size() {
        let mut writer = Writer::new(false);
        writer.text("ab");
        writer.double(1.0);
        let bytes = writer.into_bytes();
        assert_eq!(bytes[..11], [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
        assert_eq!((bytes.len(), &bytes[12..18]), (20, &[0_u8; 6][..]));
        let mut big = Writer::new(true);
        big.long(1);
        assert_eq!(big.into_bytes(), [0, 0, 0, 0, 0, 0, 0, 1]);
        let mut text = Writer::new(false);
        text.text("t1");
        assert_eq!(read_text(&text.into_bytes()), Some("t1"));
        assert_eq!(read_text(&[0, 1, 0, 0, 9, 0, 0, 0, 1]), None);
    }
}
