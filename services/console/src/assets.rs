//! The page: every file of the folder `web`, in the program.

/// A file of the page.
#[derive(Debug, Clone, Copy)]
pub struct Asset {
    /// Its path below the root of the page.
    pub path: &'static str,
    /// Its media type.
    pub kind: &'static str,
    /// Its content.
    pub bytes: &'static [u8],
}

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const PLAIN: &str = "text/plain; charset=utf-8";
const PICTURE: &str = "image/svg+xml";

macro_rules! assets {
    ($($kind:ident $path:literal),* $(,)?) => {
        &[$(Asset { path: $path, kind: $kind, bytes: include_bytes!(concat!("../web/", $path)) }),*]
    };
}

impl Asset {
    /// All files.
    pub const ALL: &'static [Self] = assets![
        HTML "index.html",
        PICTURE "icon.svg",
        SCRIPT "alerts.js",
        SCRIPT "app.js",
        SCRIPT "charts.js",
        SCRIPT "colors.js",
        SCRIPT "confirm.js",
        SCRIPT "control.js",
        SCRIPT "density.js",
        SCRIPT "drawer.js",
        SCRIPT "format.js",
        SCRIPT "frame.js",
        SCRIPT "gl.js",
        SCRIPT "history.js",
        SCRIPT "link.js",
        SCRIPT "map.js",
        SCRIPT "past.js",
        SCRIPT "services.js",
        SCRIPT "state.js",
        STYLE "style.css",
        SCRIPT "teams.js",
        SCRIPT "whatif.js",
        SCRIPT "vendor/preact.js",
        PLAIN "vendor/preact.LICENSE",
        STYLE "vendor/uPlot.css",
        SCRIPT "vendor/uPlot.js",
        PLAIN "vendor/uPlot.LICENSE",
    ];
}

/// A file of the page, ready to be sent.
#[cfg(feature = "binary")]
#[derive(Debug)]
pub struct Compressed {
    /// Its path below the root of the page.
    pub path: &'static str,
    /// Its media type.
    pub kind: &'static str,
    /// Its content.
    pub plain: &'static [u8],
    /// The same, compressed.
    pub gzip: hyper::body::Bytes,
}

#[cfg(feature = "binary")]
impl Compressed {
    /// Compresses a file.
    #[must_use]
    pub fn new(asset: &Asset) -> Self {
        use std::io::Write as _;
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        // Writing to memory does not fail.
        let _ = encoder.write_all(asset.bytes);
        let gzip = encoder.finish().unwrap_or_default().into();
        Self { path: asset.path, kind: asset.kind, plain: asset.bytes, gzip }
    }
}
