//! Picks few vectors out of many whose positive combination comes closest to a wanted one.
//!
//! Knows no light: forward selection by the largest drop of the squared residual, then exchanges of one member for one
//! candidate until none helps. With the inverse M of the members' Gram matrix, the residual after any exchange follows
//! from numbers of the present selection: taking out member p adds a_j[p]²/M_pp to what is left of candidate j.

use super::columns::dot;

/// Exchanges after each new member, for each member.
const EXCHANGES_MAX: usize = 3;
/// An exchange must lower the squared residual by this part of it.
const WORTHWHILE: f64 = 1e-2;
/// Part of a candidate's squared length that must not lie among the others already.
const INDEPENDENT: f64 = 1e-12;
/// Changes that are tried before giving up: their weights were positive by a shorter, less exact way.
const TRIALS: usize = 6;
/// Candidates that are tried by [`Exchange::grow`] when members must go.
const DESCENTS: usize = 16;

/// A selection that grows.
pub(super) struct Exchange {
    /// Scalar products of the candidates, all scaled to length 1.
    gram: Vec<Vec<f64>>,
    /// With the wanted vector.
    target: Vec<f64>,
    /// Squared length of the wanted vector.
    square: f64,
    members: Vec<usize>,
    residual: f64,
}

/// A change of the selection: who comes, and in whose place (behind the last: one more).
#[derive(Debug, Clone, Copy)]
struct Change {
    residual: f64,
    place: usize,
    candidate: usize,
}

impl Exchange {
    pub(super) fn new(vectors: &[Vec<f64>], wanted: &[f64]) -> Self {
        let count = vectors.len();
        let length: Vec<f64> = vectors
            .iter()
            .map(|v| dot(v, v).sqrt())
            .map(|l| if l > 0.0 { l } else { f64::INFINITY })
            .collect();
        let mut gram = vec![vec![0.0; count]; count];
        for i in 0..count {
            for j in 0..=i {
                let product = dot(&vectors[i], &vectors[j]) / (length[i] * length[j]);
                gram[i][j] = product;
                gram[j][i] = product;
            }
        }
        let target = vectors.iter().zip(&length).map(|(v, l)| dot(v, wanted) / l).collect();
        let square = dot(wanted, wanted);
        Self { gram, target, square, members: Vec::new(), residual: square }
    }

    /// The candidates picked, in the order of their places.
    pub(super) fn members(&self) -> &[usize] {
        &self.members
    }

    /// Squared residual of the selection, before its weights are made anew.
    pub(super) fn residual(&self) -> f64 {
        self.residual
    }

    /// Adds the candidate that helps most, then exchanges. `allowed` tells whether a candidate may stand at a place.
    /// False when there is none left that helps; then nothing changed.
    pub(super) fn grow(&mut self, allowed: &impl Fn(usize, usize) -> bool) -> bool {
        let place = self.members.len();
        if !self.apply(self.changes(place..place + 1, allowed), self.residual) && !self.add_and_drop(allowed)
        {
            return false;
        }
        self.settle(allowed);
        true
    }

    /// Takes the member away that is missed least (never the first), then exchanges. False when there is only one.
    pub(super) fn shrink(&mut self, allowed: &impl Fn(usize, usize) -> bool) -> bool {
        let without = |place: usize| {
            let mut members = self.members.clone();
            members.remove(place);
            self.positive_residual(&members).map(|residual| (residual, members))
        };
        let least = (1..self.members.len()).filter_map(without).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((residual, members)) = least else { return false };
        self.members = members;
        self.residual = residual;
        self.settle(allowed);
        true
    }

    /// Exchanges until none is worthwhile.
    fn settle(&mut self, allowed: &impl Fn(usize, usize) -> bool) {
        for _ in 0..EXCHANGES_MAX * self.members.len() {
            let limit = self.residual * (1.0 - WORTHWHILE);
            if !self.apply(self.changes(0..self.members.len(), allowed), limit) {
                break;
            }
        }
    }

    /// The best changes of these places by what they leave, best first.
    fn changes(
        &self,
        places: std::ops::Range<usize>,
        allowed: &impl Fn(usize, usize) -> bool,
    ) -> Vec<Change> {
        let count = self.members.len();
        let Some(factor) = self.factor(&self.members) else { return Vec::new() };
        let inverse = inverse(&factor);
        let own: Vec<f64> = self.members.iter().map(|&m| self.target[m]).collect();
        let weights: Vec<f64> = inverse.iter().map(|row| dot(row, &own)).collect();
        let mut changes: Vec<Change> = Vec::with_capacity(TRIALS + 1);
        let mut products = vec![0.0; count];
        for candidate in (0..self.target.len()).filter(|c| !self.members.contains(c)) {
            let gram = &self.gram[candidate];
            for (product, &member) in products.iter_mut().zip(&self.members) {
                *product = gram[member];
            }
            let along: Vec<f64> = inverse.iter().map(|row| dot(row, &products)).collect();
            let left = gram[candidate] - dot(&along, &products);
            let gain = self.target[candidate] - dot(&weights, &products);
            for place in places.clone().filter(|&place| allowed(place, candidate)) {
                let trial = match place < count {
                    true => Trial::instead(&inverse, &weights, &along, (left, gain, self.residual), place),
                    false => Trial { left, gain, residual: self.residual },
                };
                // A candidate that the others make up for, or one with a negative weight.
                if !(trial.left > INDEPENDENT && trial.gain > 0.0) {
                    continue;
                }
                let residual = trial.residual - trial.gain * trial.gain / trial.left;
                let at = changes.partition_point(|c| c.residual <= residual);
                if at < TRIALS && others_positive(&inverse, &weights, &along, place, trial.gain / trial.left)
                {
                    changes.insert(at, Change { residual, place, candidate });
                    changes.truncate(TRIALS);
                }
            }
        }
        changes
    }

    /// Where no candidate leaves the others their positive weights: adds the one of the steepest descent after which,
    /// without those that became negative, the residual is lower than before.
    fn add_and_drop(&mut self, allowed: &impl Fn(usize, usize) -> bool) -> bool {
        let Some((weights, _)) = self.solve(&self.members) else { return false };
        let gain = |candidate: usize| {
            let known =
                self.members.iter().zip(&weights).map(|(&m, w)| self.gram[candidate][m] * w).sum::<f64>();
            self.target[candidate] - known
        };
        let mut steepest: Vec<(f64, usize)> = (0..self.target.len())
            .filter(|c| !self.members.contains(c) && allowed(self.members.len(), *c))
            .map(|c| (gain(c), c))
            .filter(|(gain, _)| *gain > 0.0)
            .collect();
        steepest.sort_by(|a, b| b.0.total_cmp(&a.0));
        for &(_, candidate) in steepest.iter().take(DESCENTS) {
            let mut members = self.members.clone();
            members.push(candidate);
            // The first member keeps its place: it may be there for a reason.
            while members.len() > 1 {
                let Some((weights, residual)) = self.solve(&members) else { break };
                let worst = (1..members.len())
                    .fold(1, |worst, i| if weights[i] < weights[worst] { i } else { worst });
                if weights[worst] <= 0.0 {
                    members.remove(worst);
                } else if weights[0] > 0.0 && residual < self.residual * (1.0 - 1e-6) {
                    self.members = members;
                    self.residual = residual;
                    return true;
                } else {
                    break;
                }
            }
        }
        false
    }

    /// Makes the first of the changes that keeps all weights positive and really brings the residual below `limit`.
    fn apply(&mut self, changes: Vec<Change>, limit: f64) -> bool {
        for change in changes {
            if change.residual >= limit {
                return false;
            }
            let mut members = self.members.clone();
            if change.place < members.len() {
                members[change.place] = change.candidate;
            } else {
                members.push(change.candidate);
            }
            if let Some(residual) = self.positive_residual(&members)
                && residual < limit
            {
                self.members = members;
                self.residual = residual;
                return true;
            }
        }
        false
    }

    /// Squared residual of members whose best weights are all positive.
    fn positive_residual(&self, members: &[usize]) -> Option<f64> {
        let (weights, residual) = self.solve(members)?;
        weights.iter().all(|&w| w > 0.0).then_some(residual)
    }

    /// Best weights of members, and the squared residual that they leave.
    fn solve(&self, members: &[usize]) -> Option<(Vec<f64>, f64)> {
        let factor = self.factor(members)?;
        let count = members.len();
        let mut along = vec![0.0; count];
        for i in 0..count {
            along[i] = (self.target[members[i]] - dot(&factor[i][..i], &along[..i])) / factor[i][i];
        }
        let mut weights = vec![0.0; count];
        for i in (0..count).rev() {
            let known: f64 = (i + 1..count).map(|j| factor[j][i] * weights[j]).sum();
            weights[i] = (along[i] - known) / factor[i][i];
        }
        Some((weights, (self.square - dot(&along, &along)).max(0.0)))
    }

    /// Cholesky factor (lower) of the members' Gram matrix.
    fn factor(&self, members: &[usize]) -> Option<Vec<Vec<f64>>> {
        let mut factor: Vec<Vec<f64>> = Vec::with_capacity(members.len());
        for (i, &member) in members.iter().enumerate() {
            let mut row = vec![0.0; i + 1];
            for j in 0..i {
                let known = dot(&factor[j][..j], &row[..j]);
                row[j] = (self.gram[member][members[j]] - known) / factor[j][j];
            }
            let left = self.gram[member][member] - dot(&row[..i], &row[..i]);
            if left.is_nan() || left <= 0.1 * INDEPENDENT {
                return None;
            }
            row[i] = left.sqrt();
            factor.push(row);
        }
        Some(factor)
    }
}

/// A candidate beside the members (but one): its squared part apart from them, its product with what they leave of the
/// wanted vector, and the squared length of that.
struct Trial {
    left: f64,
    gain: f64,
    residual: f64,
}

impl Trial {
    /// In the place of a member; `beside` are the three numbers beside all members.
    fn instead(
        inverse: &[Vec<f64>],
        weights: &[f64],
        along: &[f64],
        beside: (f64, f64, f64),
        place: usize,
    ) -> Self {
        let (left, gain, residual) = beside;
        let part = 1.0 / inverse[place][place];
        Self {
            left: left + along[place] * along[place] * part,
            gain: gain + along[place] * weights[place] * part,
            residual: residual + weights[place] * weights[place] * part,
        }
    }
}

/// Whether the members (but the one at `place`) keep positive weights beside a candidate of weight `own`.
fn others_positive(inverse: &[Vec<f64>], weights: &[f64], along: &[f64], place: usize, own: f64) -> bool {
    let count = weights.len();
    let (lost, shifted) = if place < count {
        (weights[place] / inverse[place][place], along[place] / inverse[place][place])
    } else {
        (0.0, 0.0)
    };
    (0..count).filter(|&i| i != place).all(|i| {
        let through = if place < count { inverse[i][place] } else { 0.0 };
        (weights[i] - through * lost) - (along[i] - through * shifted) * own > 0.0
    })
}

/// Inverse of a matrix from its Cholesky factor.
fn inverse(factor: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let count = factor.len();
    // Columns of the inverse of the factor, from the diagonal down.
    let mut below = vec![vec![0.0; count]; count];
    for column in 0..count {
        below[column][column] = 1.0 / factor[column][column];
        for i in column + 1..count {
            let known: f64 = (column..i).map(|k| factor[i][k] * below[column][k]).sum();
            below[column][i] = -known / factor[i][i];
        }
    }
    (0..count).map(|i| (0..count).map(|j| dot(&below[i], &below[j])).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bumps that overlap with their neighbours, on 60 places.
    fn bumps() -> Vec<Vec<f64>> {
        let bump = |centre: f64| (0..60).map(|t| (-0.02 * (f64::from(t) - centre).powi(2)).exp()).collect();
        (0..60).map(|i| bump(f64::from(i))).collect()
    }

    #[test]
    fn the_vectors_that_were_mixed_are_found_again() {
        let vectors = bumps();
        let wanted: Vec<f64> =
            (0..60).map(|t| vectors[5][t] + 0.5 * vectors[30][t] + 2.0 * vectors[55][t]).collect();
        let mut exchange = Exchange::new(&vectors, &wanted);
        let mut before = f64::INFINITY;
        for _ in 0..3 {
            assert!(exchange.grow(&|_, _| true));
            assert!(exchange.residual() < before);
            before = exchange.residual();
        }
        let mut members = exchange.members().to_vec();
        members.sort_unstable();
        assert_eq!(members, [5, 30, 55]);
        // The Gram matrix squares the rounding: |wanted|² · 2⁻⁵² · a hundred operations.
        assert!(exchange.residual() < 1e-11, "{:e}", exchange.residual());
    }

    #[test]
    fn a_place_that_is_held_stays_held_and_the_shrunk_selection_is_smaller() {
        let vectors = bumps();
        let wanted: Vec<f64> = (0..60).map(|t| vectors.iter().map(|v| v[t]).sum()).collect();
        let mut exchange = Exchange::new(&vectors, &wanted);
        let held = |place: usize, candidate: usize| place > 0 || candidate >= 50;
        for _ in 0..5 {
            assert!(exchange.grow(&held));
            assert!(exchange.members()[0] >= 50, "{:?}", exchange.members());
        }
        let (count, residual) = (exchange.members().len(), exchange.residual());
        assert!(exchange.shrink(&held));
        assert!(exchange.members().len() < count && exchange.residual() >= residual);
        // Nothing left to take away but the first.
        for _ in 0..count {
            exchange.shrink(&held);
        }
        assert!(!exchange.shrink(&held) && exchange.members().len() == 1);
    }
}
