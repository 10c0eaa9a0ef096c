// The block kernel for one tile of poses: what loopcal/estimation/solve/kernel.py says, in its order.

constexpr double SINGULAR = 1e-13, REORTHOGONAL = 0.03, EPSILON = 0x1p-52;

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
static void orthonormalise(double* G, int r, int K, double* L, Room room, ivec* singular) {
    double* const row_again = room.rows(K);
    double* const more = room.rows(r);
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
static void take_values(const Reduction& job, const Linear& part, int pose, int count, Room room, double* f) {
    const int m = job.program->loops, k = job.program->inputs;
    if (!job.rounding) {
        for (int i = 0; i < m; i++) EACH store(f + i * TILE + v * LANES, part.f[i][v]);
        return;
    }
    double* const readings = room.rows(k);
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
static Reflections eliminate(const Noise& noise, const Linear& part, Room& room) {
    const int m = part.program->loops, u = noise.unmeasured_count;
    const Reflections found = {u, m, room.rows(u * m), room.rows(u), room.rows(u * m)};
    for (int j = 0; j < u; j++)
        for (int i = 0; i < m; i++)
            EACH store(found.column(j, i) + v * LANES, part.J[noise.unmeasured[j] * m + i][v]);
    found.triangularise();
    return found;
}

// The derivatives (k, r) by measured quantities of the loops that are left.
static const View* combined(const Noise& noise, const Linear& part, const double* left, Room& room) {
    const int m = part.program->loops, r = m - noise.unmeasured_count;
    View* const found = views(room, part.program->quantities * r);
    for (int k = 0; k < noise.measured_count; k++) {
        const int q = noise.measured[k];
        double* const rows = room.rows(r);
        combine(left, r, m, part.J + (ptrdiff_t)q * m, part.of_quantity(q), rows);
        for (int i = 0; i < r; i++) found[q * r + i] = {rows + i * TILE};
    }
    return found;
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

// Rows of D, (n, r) at `out`, from the derivatives by parameters; `left` where quantities are unmeasured.
static void whiten_parameters(const Linear& part, int n, int r, const double* left, const double* inverse, Room room,
                              double* out) {
    const WhitenColumns whiten_them = WHITEN_COLUMNS[r <= 6 ? r : 0];
    if (!left) return whiten_them(part.D, n, r, inverse, out);
    const int m = part.program->loops;
    double* const rows = room.rows(r);
    View* const column = views(room, r);
    for (int i = 0; i < r; i++) column[i] = {rows + i * TILE};
    for (int p = 0; p < n; p++) {
        combine_without_rounding(left, r, m, part.D + (ptrdiff_t)p * m, part.of_parameter(p), rows);
        whiten_them(column, 1, r, inverse, out + (ptrdiff_t)p * r * PIECE);
    }
}

// The whitened equations E and the corrections they lead to; E at `out`, D ahead of it.
static void whiten_uncertain(const Reduction& job, const Linear& part, const double* f, const double* now,
                             const Uncertainty& uncertainty, Room room, double* out, double* correction,
                             ivec* singular) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops, skip = noise.unmeasured_count, r = m - skip;
    const int K = noise.measured_count, n = job.by_parameter ? job.program->parameters : 0;
    double* const E = out + (ptrdiff_t)n * r * PIECE;
    double* const rest = room.rows(m);
    memset(rest, 0, sizeof(double) * m * TILE);
    add_moves(noise, part, [&](int q, int v) { return load(now + q * TILE + v * LANES); }, rest);
    for (int i = 0; i < m * TILE; i += LANES) store(rest + i, load(rest + i) - load(f + i));
    Reflections reflections{};
    const View* slopes = part.J;
    double* left = nullptr;
    if (skip) {
        reflections = eliminate(noise, part, room);
        reflections.apply(rest);
        left = room.rows(r * m);
        reflections.leave(left);
        slopes = combined(noise, part, left, room);
    }
    double* const G = room.rows(r * K);
    double* const L = room.rows(r * r);
    load_rows(noise, slopes, r, uncertainty, G);
    orthonormalise(G, r, K, L, room, singular);
    for (int i = 0; i < r; i++)
        EACH {
            vec e = load(rest + (skip + i) * TILE + v * LANES);
            for (int j = 0; j < i; j++)
                e -= load(L + ((ptrdiff_t)i * r + j) * TILE + v * LANES) * load(E + (ptrdiff_t)j * PIECE + v * LANES);
            store(E + (ptrdiff_t)i * PIECE + v * LANES, e / load(L + ((ptrdiff_t)i * r + i) * TILE + v * LANES));
        }
    if (n && r) {
        double* const inverse = room.rows(r * r);
        invert(L, r, inverse);
        whiten_parameters(part, n, r, left, inverse, room, out);
    }
    unload(job, G, E, uncertainty, room.rows(K), correction);
    if (!skip) return;
    memcpy(rest, f, sizeof(double) * m * TILE);
    add_moves(
        noise, part,
        [&](int q, int v) { return load(correction + q * TILE + v * LANES) - load(now + q * TILE + v * LANES); }, rest);
    reflections.apply(rest);
    move_unmeasured(reflections, noise, rest, now, correction);
}

// The same for exact sensors: D = J_p, E = -f, and only unmeasured quantities are found.
static void leave_unweighted(const Reduction& job, const Linear& part, double* f, const double* now, Room room,
                             double* out, double* correction) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops, k = job.program->quantities, skip = noise.unmeasured_count;
    const int r = m - skip, n = job.by_parameter ? job.program->parameters : 0;
    memcpy(correction, now, sizeof(double) * k * TILE);
    if (skip) {
        const Reflections reflections = eliminate(noise, part, room);
        reflections.apply(f);
        double* const left = room.rows(r * m);
        double* const rows = room.rows(r);
        reflections.leave(left);
        for (int p = 0; p < n; p++) {
            combine_without_rounding(left, r, m, part.D + (ptrdiff_t)p * m, part.of_parameter(p), rows);
            for (int i = 0; i < r; i++)
                memcpy(out + ((ptrdiff_t)p * r + i) * PIECE, rows + i * TILE, sizeof(double) * TILE);
        }
        move_unmeasured(reflections, noise, f, now, correction);
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
                      const Uncertainty& uncertainty, Room room, double* out, double* correction, vec* most,
                      ivec* singular) {
    const Program& program = *job.program;
    const int k = program.inputs, m = program.loops;
    double* const x = workspace + program.first;
    fill(x, job.readings, k, pose, count);
    fill(x + k * TILE, job.known, program.known, pose, count);
    for (int i = 0; i < k * TILE; i += LANES) store(x + i, load(x + i) + load(now + i));
    run(program, workspace, job.by_parameter ? 2 : 1);

    double* const f = room.rows(m);
    take_values(job, part, pose, count, room, f);
    if (job.rounding) memset(now, 0, sizeof(double) * k * TILE);
    if (job.exact)
        leave_unweighted(job, part, f, now, room, out, correction);
    else
        whiten_uncertain(job, part, f, now, uncertainty, room, out, correction, singular);
    longest(now, correction, uncertainty.inverse, k, most);
}

// The same of the poses from `pose` on, `count` of them, at their corrections, with the results where the job wants them.
static void whiten(const Reduction& job, int pose, int count, double* workspace, double* out,
                   const Linear& part, const Uncertainty& uncertainty, Room room) {
    const Program& program = *job.program;
    const int k = program.inputs, r = program.loops - job.noise->unmeasured_count;
    const int width = job.by_parameter ? program.parameters + 1 : 1;
    double* const now = room.rows(k);
    double* const correction = room.rows(k);
    vec most[TV];
    ivec singular[TV] = {};
    fill(now, job.corrections, k, pose, count);
    fill_by_pose(*job.noise, k, pose, count, uncertainty);
    whiten_at(job, now, pose, count, workspace, part, uncertainty, room, out, correction, most, singular);
    for (int q = 0; q < k; q++)
        take_row(job.correction + q * job.correction_row + pose, correction + q * TILE, count);
    EACH store(now + v * LANES, most[v]);  // its row is free
    take_row(job.step + pose, now, count);
    for (int p = 0; p < count; p++) job.singular[pose + p] = singular[p / LANES][p % LANES] != 0;
    if (count < TILE)
        for (int i = 0; i < width * r; i++)
            for (int p = count; p < TILE; p++) out[(ptrdiff_t)i * PIECE + p] = 0.0;
}
