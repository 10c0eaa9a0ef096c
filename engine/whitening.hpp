// The block kernel for one tile of poses: what loopcal/estimation/solve/kernel.py says, in its order.

constexpr double SINGULAR = 1e-13, REORTHOGONAL = 0.03, EPSILON = 0x1p-52;

// Rows of a tile that is whitened.
struct Whitening {
    double *now, *correction;  // (k)
    double *f, *rest;          // (m)
    double* readings;          // (k)
    Reflections reflections;
    double *left, *combined;  // (r, m), (K, r): where quantities are unmeasured
    View *slopes, *column;    // (k, r), (r)
    double *G, *L, *inverse;  // (r, K), (r, r), (r, r)
    double *again, *more;     // (K), (r)
    double *rows, *normalised;  // (r), (K)
    Own own;                    // where loops have readings of their own: no row but readings and f is used beside it
};

static Whitening whitening(const Program& program, const Noise& noise, Room& room) {
    const int m = program.loops, k = program.inputs, u = noise.unmeasured_count, r = m - u, K = noise.measured_count;
    Whitening found{};
    found.now = room.rows(k), found.correction = room.rows(k);
    found.f = room.rows(m), found.rest = room.rows(m), found.readings = room.rows(k);
    if (noise.own) {
        found.own = own_rows(program, noise, room);
        return found;
    }
    if (u) {
        found.reflections = reflections(u, m, room);
        found.left = room.rows(r * m), found.combined = room.rows(K * r);
        found.slopes = views(room, k * r), found.column = views(room, r);
    }
    found.G = room.rows(r * K), found.L = room.rows(r * r), found.inverse = room.rows(r * r);
    found.again = room.rows(K), found.more = room.rows(r);
    found.rows = room.rows(r), found.normalised = room.rows(K);
    return found;
}

// Row minus its part in the span of orthonormal rows; overlaps: added to where they are wanted.
static void project(double* row, const double* basis, int rows, int K, double* overlaps) {
    for (int j = 0; j < rows; j++) {
        const double* const unit = basis + (ptrdiff_t)j * K * TILE;
        vec overlap[TV] = {};
        for (int k = 0; k < K; k++)
            EACH overlap[v] += load(row + k * TILE + v * LANES) * load(unit + k * TILE + v * LANES);
        for (int k = 0; k < K; k++)
            EACH {
                double* const at = row + k * TILE + v * LANES;
                store(at, load(at) - overlap[v] * load(unit + k * TILE + v * LANES));
            }
        EACH store(overlaps + j * TILE + v * LANES, overlap[v]);
    }
}

INLINE void squares(const double* row, int K, vec* length) {
    EACH length[v] = all(0.0);
    for (int k = 0; k < K; k++)
        EACH {
            const vec a = load(row + k * TILE + v * LANES);
            length[v] += a * a;
        }
}

// G = L Q^T with Q^T left in G (r, K); L: (r, r). A row of which little is left is swept twice,
// only for the poses where it is so: no pose depends on its neighbours.
static void orthonormalise(const Whitening& to, int r, int K, ivec* singular) {
    double *const G = to.G, *const L = to.L, *const row_again = to.again, *const more = to.more;
    for (int i = 0; i < r; i++) {
        double* const row = G + (ptrdiff_t)i * K * TILE;
        double* const overlaps = L + (ptrdiff_t)i * r * TILE;
        project(row, G, i, K, overlaps);
        vec length[TV], before[TV];
        ivec again[TV], whether = {};
        squares(row, K, length);
        EACH before[v] = length[v];
        for (int j = 0; j < i; j++)
            EACH {
                const vec a = load(overlaps + j * TILE + v * LANES);
                before[v] += a * a;
            }
        EACH whether |= again[v] = ~(length[v] > all(REORTHOGONAL * REORTHOGONAL) * before[v]);
        if (__builtin_expect(any(whether), 0)) {
            memcpy(row_again, row, sizeof(double) * K * TILE);
            project(row_again, G, i, K, more);
            for (int j = 0; j < i; j++)
                EACH {
                    double* const at = overlaps + j * TILE + v * LANES;
                    store(at, choose(again[v], load(at) + load(more + j * TILE + v * LANES), load(at)));
                }
            for (int k = 0; k < K; k++)
                EACH {
                    double* const at = row + k * TILE + v * LANES;
                    store(at, choose(again[v], load(row_again + k * TILE + v * LANES), load(at)));
                }
            vec second[TV];
            squares(row, K, second);
            EACH {
                const ivec bad = again[v] & ~(second[v] > all(SINGULAR * SINGULAR) * before[v]);
                singular[v] |= bad;
                length[v] = choose(bad, all(1.0), second[v]);
            }
        }
        EACH {
            const vec whole = root(length[v]);
            store(overlaps + i * TILE + v * LANES, whole);
            length[v] = all(1.0) / whole;
        }
        for (int k = 0; k < K; k++)
            EACH {
                double* const at = row + k * TILE + v * LANES;
                store(at, load(at) * length[v]);
            }
    }
}

// L^-1 of lower triangles, (r, r)
static void invert(const double* L, int r, double* inverse) {
    for (int i = 0; i < r; i++) {
        EACH {
            const vec pivot = all(1.0) / load(L + ((ptrdiff_t)i * r + i) * TILE + v * LANES);
            store(inverse + ((ptrdiff_t)i * r + i) * TILE + v * LANES, pivot);
            for (int j = 0; j < i; j++) {
                vec total = {};
                for (int k = j; k < i; k++)
                    total += load(L + ((ptrdiff_t)i * r + k) * TILE + v * LANES) *
                             load(inverse + ((ptrdiff_t)k * r + j) * TILE + v * LANES);
                store(inverse + ((ptrdiff_t)i * r + j) * TILE + v * LANES, -pivot * total);
            }
        }
    }
}

// L^-1 times derivatives by parameters, (n, r) views, to rows (n, r) at `out`.
template <int R>
static void whiten_columns(const View* D, int n, int r, const double* inverse, double* out) {
    const int rows = R ? R : r;
    EACH {
        for (int p = 0; p < n; p++) {
            const View* const column = D + (ptrdiff_t)p * rows;
            double* const to = out + (ptrdiff_t)p * rows * PIECE + v * LANES;
            for (int i = 0; i < rows; i++) {
                vec total = load(inverse + (ptrdiff_t)i * rows * TILE + v * LANES) * column[0][v];
                for (int j = 1; j <= i; j++)
                    total += load(inverse + ((ptrdiff_t)i * rows + j) * TILE + v * LANES) * column[j][v];
                store(to + i * PIECE, total);
            }
        }
    }
}

using WhitenColumns = void (*)(const View*, int, int, const double*, double*);
constexpr WhitenColumns WHITEN_COLUMNS[] = {whiten_columns<0>, whiten_columns<1>, whiten_columns<2>, whiten_columns<3>,
                                            whiten_columns<4>, whiten_columns<5>, whiten_columns<6>};

// The loop values; or what rounding does to each, eps times the size of its terms, sum |df/dx| (1 + |reading|).
static void take_values(const Reduction& job, const Linear& part, int pose, int count, double* readings, double* f) {
    const int m = job.program->loops, k = job.program->inputs;
    if (!job.rounding) {
        for (int i = 0; i < m; i++) EACH store(f + i * TILE + v * LANES, part.f[i][v]);
        return;
    }
    fill(readings, job.readings, k, pose, count);
    for (int i = 0; i < m; i++) {
        vec total[TV] = {};
        for (int q = 0; q < k; q++)
            EACH total[v] += magnitude(part.J[q * m + i][v]) *
                             (all(1.0) + magnitude(load(readings + q * TILE + v * LANES)));
        EACH store(f + i * TILE + v * LANES, all(EPSILON) * total[v]);
    }
}

// values += the sum over the measured quantities of their derivatives times their moves.
template <class Move>
static void add_moves(const Noise& noise, const Linear& part, Move move, double* values) {
    for (int k = 0; k < noise.measured_count; k++) {
        const int q = noise.measured[k];
        const Loops loops = part.of_quantity(q);
        const View* const slopes = part.J + (ptrdiff_t)q * part.program->loops;
        for (const int32_t* loop = loops.begin; loop != loops.end; loop++)
            EACH {
                double* const at = values + *loop * TILE + v * LANES;
                store(at, load(at) + slopes[*loop][v] * move(q, v));
            }
    }
}

// What eliminates the unmeasured quantities from a tile.
static void eliminate(const Noise& noise, const Linear& part, const Reflections& to) {
    const int m = part.program->loops;
    for (int j = 0; j < noise.unmeasured_count; j++)
        for (int i = 0; i < m; i++)
            EACH store(to.column(j, i) + v * LANES, part.J[noise.unmeasured[j] * m + i][v]);
    to.triangularise();
}

// The derivatives (k, r) by measured quantities of the loops that are left.
static void combine_all(const Noise& noise, const Linear& part, const Whitening& to) {
    const int m = part.program->loops, r = m - noise.unmeasured_count;
    for (int k = 0; k < noise.measured_count; k++) {
        const int q = noise.measured[k];
        double* const rows = to.combined + (ptrdiff_t)k * r * TILE;
        combine(to.left, r, m, part.J + (ptrdiff_t)q * m, part.of_quantity(q), rows);
        for (int i = 0; i < r; i++) to.slopes[q * r + i] = {rows + i * TILE};
    }
}

// G = J S, (r, K)
static void load_rows(const Noise& noise, const View* J, int r, const Uncertainty& uncertainty, double* G) {
    const int K = noise.measured_count;
    for (int i = 0; i < r; i++)
        for (int k = 0; k < K; k++) {
            const View slope = J[noise.measured[k] * r + i];
            const double* const sd = uncertainty.sds + noise.measured[k] * TILE;
            EACH store(G + ((ptrdiff_t)i * K + k) * TILE + v * LANES, slope[v] * load(sd + v * LANES));
        }
    for (int b = 0; b < noise.block_count; b++) {
        const Covariance& block = noise.blocks[b];
        for (int i = 0; i < r; i++)
            for (int d = 0; d < block.size; d++)
                EACH {
                    vec total = {};
                    for (int c = 0; c < block.size; c++)
                        total += J[noise.measured[block.places[c]] * r + i][v] *
                                 load(uncertainty.factors[b] + (c * block.size + d) * TILE + v * LANES);
                    store(G + ((ptrdiff_t)i * K + block.places[d]) * TILE + v * LANES, total);
                }
    }
}

// correction = S Q E of the measured quantities, into rows of all quantities
static void unload(const Reduction& job, const double* G, const double* E, const Uncertainty& uncertainty,
                   double* normalised, double* correction) {
    const Noise& noise = *job.noise;
    const int K = noise.measured_count, r = job.program->loops - noise.unmeasured_count;
    for (int k = 0; k < K; k++) {
        vec total[TV] = {};
        for (int i = 0; i < r; i++)
            EACH total[v] += load(G + ((ptrdiff_t)i * K + k) * TILE + v * LANES) *
                             load(E + (ptrdiff_t)i * PIECE + v * LANES);
        const int q = noise.measured[k];
        EACH {
            store(normalised + k * TILE + v * LANES, total[v]);
            store(correction + q * TILE + v * LANES, total[v] * load(uncertainty.sds + q * TILE + v * LANES));
        }
    }
    for (int b = 0; b < noise.block_count; b++) {
        const Covariance& block = noise.blocks[b];
        for (int c = 0; c < block.size; c++)
            EACH {
                vec total = {};
                for (int d = 0; d < block.size; d++)
                    total += load(uncertainty.factors[b] + (c * block.size + d) * TILE + v * LANES) *
                             load(normalised + block.places[d] * TILE + v * LANES);
                store(correction + noise.measured[block.places[c]] * TILE + v * LANES, total);
            }
    }
}

// Unmeasured quantities moved to where they close the first u rows of reflected loops, best as the rest may be.
static void move_unmeasured(const Reflections& reflections, const Noise& noise, double* rows, const double* now,
                            double* correction) {
    reflections.solve(rows);
    for (int i = 0; i < reflections.u; i++) {
        const int q = noise.unmeasured[i];
        EACH store(correction + q * TILE + v * LANES,
                   load(now + q * TILE + v * LANES) - load(rows + i * TILE + v * LANES));
    }
}

// Rows of D, (n, r) at `out`, from the derivatives by parameters.
static void whiten_parameters(const Linear& part, int n, int r, const Whitening& to, double* out) {
    const WhitenColumns whiten_them = WHITEN_COLUMNS[r <= 6 ? r : 0];
    if (!to.left) return whiten_them(part.D, n, r, to.inverse, out);
    const int m = part.program->loops;
    for (int i = 0; i < r; i++) to.column[i] = {to.rows + i * TILE};
    for (int p = 0; p < n; p++) {
        combine_without_rounding(to.left, r, m, part.D + (ptrdiff_t)p * m, part.of_parameter(p), to.rows);
        whiten_them(to.column, 1, r, to.inverse, out + (ptrdiff_t)p * r * PIECE);
    }
}

// The whitened equations E and the corrections they lead to; E at `out`, D ahead of it.
static void whiten_uncertain(const Reduction& job, const Linear& part, const double* now, const Uncertainty& uncertainty,
                             const Whitening& to, double* out, double* correction, ivec* singular) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops, skip = noise.unmeasured_count, r = m - skip;
    const int K = noise.measured_count, n = part.n;
    double* const E = out + (ptrdiff_t)n * r * PIECE;
    double *const rest = to.rest, *const L = to.L;
    memset(rest, 0, sizeof(double) * m * TILE);
    add_moves(noise, part, [&](int q, int v) { return load(now + q * TILE + v * LANES); }, rest);
    for (int i = 0; i < m * TILE; i += LANES) store(rest + i, load(rest + i) - load(to.f + i));
    if (skip) {
        eliminate(noise, part, to.reflections);
        to.reflections.apply(rest);
        to.reflections.leave(to.left);
        combine_all(noise, part, to);
    }
    load_rows(noise, skip ? to.slopes : part.J, r, uncertainty, to.G);
    orthonormalise(to, r, K, singular);
    for (int i = 0; i < r; i++)
        EACH {
            vec e = load(rest + (skip + i) * TILE + v * LANES);
            for (int j = 0; j < i; j++)
                e -= load(L + ((ptrdiff_t)i * r + j) * TILE + v * LANES) * load(E + (ptrdiff_t)j * PIECE + v * LANES);
            store(E + (ptrdiff_t)i * PIECE + v * LANES, e / load(L + ((ptrdiff_t)i * r + i) * TILE + v * LANES));
        }
    if (n && r) {
        invert(L, r, to.inverse);
        whiten_parameters(part, n, r, to, out);
    }
    unload(job, to.G, E, uncertainty, to.normalised, correction);
    if (!skip) return;
    memcpy(rest, to.f, sizeof(double) * m * TILE);
    add_moves(
        noise, part,
        [&](int q, int v) { return load(correction + q * TILE + v * LANES) - load(now + q * TILE + v * LANES); }, rest);
    to.reflections.apply(rest);
    move_unmeasured(to.reflections, noise, rest, now, correction);
}

// The same for exact sensors: D = J_p, E = -f, and only unmeasured quantities are found.
static void leave_unweighted(const Reduction& job, const Linear& part, const double* now, const Whitening& to, double* out,
                             double* correction) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops, k = job.program->quantities, skip = noise.unmeasured_count;
    const int r = m - skip, n = part.n;
    double* const f = to.f;
    memcpy(correction, now, sizeof(double) * k * TILE);
    if (skip) {
        eliminate(noise, part, to.reflections);
        to.reflections.apply(f);
        to.reflections.leave(to.left);
        for (int p = 0; p < n; p++) {
            combine_without_rounding(to.left, r, m, part.D + (ptrdiff_t)p * m, part.of_parameter(p), to.rows);
            for (int i = 0; i < r; i++)
                memcpy(out + ((ptrdiff_t)p * r + i) * PIECE, to.rows + i * TILE, sizeof(double) * TILE);
        }
        move_unmeasured(to.reflections, noise, f, now, correction);
    } else {
        for (int i = 0; i < n * m; i++) EACH store(out + (ptrdiff_t)i * PIECE + v * LANES, part.D[i][v]);
    }
    for (int i = 0; i < r; i++)
        EACH store(out + ((ptrdiff_t)n * r + i) * PIECE + v * LANES, -load(f + (skip + i) * TILE + v * LANES));
}

// The longest move of each pose in sds; no number where one of them is none.
static void longest(const double* now, const double* correction, const double* inverse, int k, vec* most) {
    EACH most[v] = all(0.0);
    for (int q = 0; q < k; q++)
        EACH {
            const vec move = magnitude(load(correction + q * TILE + v * LANES) - load(now + q * TILE + v * LANES));
            const vec size = move * load(inverse + q * TILE + v * LANES);
            most[v] = choose((size > most[v]) | (size != size), size, most[v]);
        }
}

// A tile linearised at readings + `now` (k): rows of D and E to out (n + 1, r, PIECE), the new corrections (k), their
// longest moves in sds, and where loops cannot close.
static void whiten_at(const Reduction& job, double* now, int pose, int count, double* workspace, const Linear& part,
                      const Uncertainty& uncertainty, const Whitening& to, double* out, double* correction, vec* most,
                      ivec* singular) {
    const Program& program = *job.program;
    const int k = program.inputs;
    double* const x = workspace + program.first;
    fill(x, job.readings, k, pose, count);
    fill(x + k * TILE, job.known, program.known, pose, count);
    for (int i = 0; i < k * TILE; i += LANES) store(x + i, load(x + i) + load(now + i));
    run(program, workspace, !job.by_parameter ? 1 : part.columns ? 2 : 3);

    take_values(job, part, pose, count, to.readings, to.f);
    if (job.rounding) memset(now, 0, sizeof(double) * k * TILE);
    if (job.noise->own)
        whiten_own(job, part, now, uncertainty, to.f, to.own, out, correction);
    else if (job.exact)
        leave_unweighted(job, part, now, to, out, correction);
    else
        whiten_uncertain(job, part, now, uncertainty, to, out, correction, singular);
    longest(now, correction, uncertainty.inverse, k, most);
}

// The same of the poses from `pose` on, `count` of them, at their corrections, with the results where the job wants them.
static void whiten(const Reduction& job, int pose, int count, double* workspace, double* out,
                   const Linear& part, const Uncertainty& uncertainty, const Whitening& to) {
    const Program& program = *job.program;
    const int k = program.inputs, r = program.loops - job.noise->unmeasured_count;
    const int width = part.n + 1;
    double *const now = to.now, *const correction = to.correction;
    vec most[TV];
    ivec singular[TV] = {};
    fill(now, job.corrections, k, pose, count);
    fill_by_pose(*job.noise, k, pose, count, uncertainty);
    whiten_at(job, now, pose, count, workspace, part, uncertainty, to, out, correction, most, singular);
    for (int q = 0; q < k; q++)
        take_row(job.correction + q * job.correction_row + pose, correction + q * TILE, count);
    EACH store(now + v * LANES, most[v]);  // its row is free
    take_row(job.step + pose, now, count);
    for (int p = 0; p < count; p++) job.singular[pose + p] = singular[p / LANES][p % LANES] != 0;
    if (count < TILE)
        for (int i = 0; i < width * r; i++)
            for (int p = count; p < TILE; p++) out[(ptrdiff_t)i * PIECE + p] = 0.0;
}
