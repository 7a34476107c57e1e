//! k-means without limits takes the recorded path, bit for bit.
use crate::common::{blobs, numbers};
use muster_numeric::kmeans::{Init, KMeansOptions, kmeans};

/// Digest of labels and centroids (FNV-1a), and the iterations, of each seed: cold with both ways to seed, warm
/// with hysteresis, and warm into one cluster less. Sums of single coordinates are the same on every processor.
const RECORDED: [[(u64, usize); 4]; 5] = [
    [
        (0xc7c8_f918_3e5f_4290, 8),
        (0xc7c8_f918_3e5f_4290, 17),
        (0x8c33_a80f_93ad_b9f3, 4),
        (0x33e3_7a7d_002a_6558, 5),
    ],
    [
        (0xf36c_2ffc_bc43_adf7, 10),
        (0xf36c_2ffc_bc43_adf7, 16),
        (0xb3b3_7fde_d6b3_0818, 3),
        (0x6022_74c4_52ab_2109, 6),
    ],
    [
        (0xe13d_2bd0_cefb_5f7e, 12),
        (0xba7e_c096_e81e_ca14, 14),
        (0x787f_8ec3_ed19_3629, 5),
        (0xbd5d_eafe_b3bf_4e31, 9),
    ],
    [
        (0xdfb6_7f73_e72d_3424, 19),
        (0xa9c4_f8f4_5069_657f, 8),
        (0x65ce_549f_0f68_328c, 2),
        (0x4ee2_9685_eb6f_ccb1, 8),
    ],
    [
        (0xf3d3_50a9_eefa_d14d, 13),
        (0xc0c0_d8f4_f4b3_df28, 14),
        (0xce80_b944_2452_8109, 4),
        (0x19bb_ebbd_374f_8c32, 8),
    ],
];

fn digest(values: impl Iterator<Item = u64>) -> u64 {
    let bytes = values.flat_map(u64::to_le_bytes);
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

#[test]
fn paths_and_results_are_the_recorded_ones() {
    for (seed, recorded) in RECORDED.iter().enumerate() {
        let seed = seed as u64 + 1;
        let centres: [&[f64]; 5] = [
            &[0.0, 0.0, 0.3],
            &[1.0, 0.3, 0.0],
            &[0.2, 1.1, 0.5],
            &[1.0, 1.4, 0.2],
            &[2.0, 0.7, 1.0],
        ];
        let x = blobs(&centres, 40, 0.7, seed);
        let mut random = numbers(seed);
        let warm: Vec<Option<usize>> = (0..200)
            .map(|i| (random() < 0.9).then(|| if random() < 0.8 { i / 40 } else { i % 5 }))
            .collect();
        let cold = KMeansOptions { seed, restarts: 6, ..KMeansOptions::new(5) };
        let cases = [
            cold,
            KMeansOptions { init: Init::Random, ..cold },
            KMeansOptions { warm_labels: Some(&warm), hysteresis: 0.2, ..cold },
            KMeansOptions { warm_labels: Some(&warm), hysteresis: 0.9, clusters: 4, ..cold },
        ];
        let found = cases.map(|options| {
            let found = kmeans(&x, &options).unwrap();
            let labels = found.labels.iter().map(|label| *label as u64);
            let centroids = found.centroids.data().iter().map(|value| value.to_bits());
            (digest(labels.chain(centroids)), found.iterations)
        });
        assert_eq!(&found, recorded, "seed {seed}");
    }
}
