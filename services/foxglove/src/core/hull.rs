//! The convex hull of a team on the ground.

/// The corners of the convex hull, counter-clockwise, at the mean height of all points: two for points on a line, none for
/// less than two places.
pub(super) fn hull(places: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut points: Vec<[f64; 2]> = places.iter().map(|at| [at[0], at[1]]).collect();
    points.sort_unstable_by(|left, right| {
        left[0].total_cmp(&right[0]).then(left[1].total_cmp(&right[1]))
    });
    points.dedup();
    if points.len() < 2 {
        return Vec::new();
    }
    // The monotone chain of Andrew: the lower half from left to right, then the upper one back.
    let mut corners = chain(points.iter());
    corners.extend(chain(points.iter().rev()));
    let height = places.iter().map(|at| at[2]).sum::<f64>() / places.len() as f64;
    corners.into_iter().map(|[x, y]| [x, y, height]).collect()
}

/// One half of the hull without its last corner, which begins the other half.
fn chain<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Vec<[f64; 2]> {
    let mut chain: Vec<[f64; 2]> = Vec::new();
    for point in points {
        while let [.., before, last] = chain.as_slice() {
            let (a, b) = (
                [last[0] - before[0], last[1] - before[1]],
                [point[0] - before[0], point[1] - before[1]],
            );
            if a[0] * b[1] - a[1] * b[0] > 0.0 {
                break;
            }
            chain.pop();
        }
        chain.push(*point);
    }
    chain.pop();
    chain
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn small_teams_have_small_hulls() {
        assert!(hull(&[]).is_empty());
        assert!(hull(&[[1.0, 2.0, 3.0]]).is_empty());
        assert!(hull(&[[1.0, 2.0, 3.0], [1.0, 2.0, 5.0]]).is_empty(), "two at one place");
        assert_eq!(hull(&[[0.0, 0.0, 1.0], [2.0, 0.0, 3.0]]), [[0.0, 0.0, 2.0], [2.0, 0.0, 2.0]]);
        let square = [
            [0.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [2.0, 0.0, 0.0],
            [2.0, 2.0, 0.0],
            [0.0, 2.0, 0.0],
            [1.0, 0.0, 0.0],
        ];
        let corners = hull(&square);
        assert_eq!(corners, [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [0.0, 2.0, 0.0]]);
    }

    proptest! {
        #[test]
        fn no_robot_is_outside_and_every_corner_is_a_robot(
            places in prop::collection::vec([-50_i32..50, -50_i32..50], 3..60)
        ) {
            let places: Vec<[f64; 3]> =
                places.iter().map(|[x, y]| [f64::from(*x), f64::from(*y), 0.0]).collect();
            let corners = hull(&places);
            for corner in &corners {
                prop_assert!(places.contains(corner));
            }
            for (at, from) in corners.iter().enumerate() {
                let to = corners[(at + 1) % corners.len()];
                for [x, y, _] in &places {
                    let side = (to[0] - from[0]) * (y - from[1]) - (to[1] - from[1]) * (x - from[0]);
                    prop_assert!(side >= 0.0, "{x}, {y} is right of {from:?} to {to:?}");
                }
            }
        }
    }
}
