// Poses whose loops have readings of their own, images, for one tile: what `whiten_own` of
// loopcal/estimation/solve/kernel.py says, in its order.

// Rows of a tile that is whitened so; u + s columns of m + s rows are triangularised.
struct Own {
    Reflections reflections;
    double *weight, *rest;   // (m)
    double *turned, *column;  // (m + s)
};

static Own own_rows(const Program& program, const Noise& noise, Room& room) {
    if (!noise.own) return {};
    const int m = program.loops, s = noise.shared_count, columns = noise.unmeasured_count + s;
    Own found{};
    found.reflections = reflections(columns, m + s, room);
    found.weight = room.rows(m), found.rest = room.rows(m);
    found.turned = room.rows(m + s), found.column = room.rows(m + s);
    return found;
}

static void weigh_own(const Reduction& job, const Linear& part, const Uncertainty& uncertainty, const Own& to) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops;
    for (int i = 0; i < m; i++)
        EACH {
            const int q = noise.own[i];
            const vec sd = load(uncertainty.sds + q * TILE + v * LANES);
            const ivec missing = sd == all(INFINITY);
            const vec weight = job.exact ? all(1.0) : all(1.0) / (magnitude(part.J[q * m + i][v]) * sd);
            store(to.weight + i * TILE + v * LANES, choose(missing, all(0.0), weight));
        }
}

// A derivative of the loops, weighted, with zeros below, reflected; zeros where it always is.
static void reflect_own(const Own& to, int m, int s, const View* derivative, Loops loops, double* out) {
    memset(out, 0, sizeof(double) * (m + s) * TILE);
    for (const int32_t* loop = loops.begin; loop != loops.end; loop++)
        EACH store(out + *loop * TILE + v * LANES,
                   derivative[*loop][v] * load(to.weight + *loop * TILE + v * LANES));
}

// values -= the derivatives by a quantity times its move, in the loops that it is in
template <class Move>
static void take_move(const Linear& part, int q, Move move, double* values) {
    const Loops loops = part.of_quantity(q);
    const View* const slopes = part.J + (ptrdiff_t)q * part.program->loops;
    for (const int32_t* loop = loops.begin; loop != loops.end; loop++)
        EACH {
            double* const at = values + *loop * TILE + v * LANES;
            store(at, load(at) - slopes[*loop][v] * move(v));
        }
}

static void whiten_own(const Reduction& job, const Linear& part, const double* now, const Uncertainty& uncertainty,
                       const double* f, const Own& to, double* out, double* correction) {
    const Noise& noise = *job.noise;
    const Program& program = *job.program;
    const int m = program.loops, k = program.inputs, u = noise.unmeasured_count;
    const int s = job.exact ? 0 : noise.shared_count, r = m - u, n = part.n;
    Reflections reflections = to.reflections;
    reflections.u = u + s, reflections.m = m + s;
    weigh_own(job, part, uncertainty, to);
    for (int j = 0; j < u; j++) {
        const int q = noise.unmeasured[j];
        reflect_own(to, m, s, part.J + (ptrdiff_t)q * m, part.of_quantity(q), reflections.column(j, 0));
    }
    for (int j = 0; j < s; j++) {
        double* const column = reflections.column(u + j, 0);
        const int q = noise.shared[j];
        reflect_own(to, m, s, part.J + (ptrdiff_t)q * m, part.of_quantity(q), column);
        for (int i = 0; i < m; i++)
            EACH {
                double* const at = column + i * TILE + v * LANES;
                store(at, load(at) * load(uncertainty.sds + q * TILE + v * LANES));
            }
        EACH store(column + (m + j) * TILE + v * LANES, all(1.0));
    }
    for (int b = 0; s && b < noise.block_count; b++) {
        const Covariance& block = noise.blocks[b];
        for (int d = 0; d < block.size; d++) {
            double* const column = reflections.column(u + block.places[d], 0);
            for (int i = 0; i < m; i++)
                EACH {
                    vec total = {};
                    for (int c = 0; c < block.size; c++)
                        total += part.J[noise.shared[block.places[c]] * m + i][v] *
                                 load(uncertainty.factors[b] + (c * block.size + d) * TILE + v * LANES);
                    store(column + i * TILE + v * LANES, total * load(to.weight + i * TILE + v * LANES));
                }
        }
    }
    double* const rest = to.rest;
    for (int i = 0; i < m; i++) EACH store(rest + i * TILE + v * LANES, -load(f + i * TILE + v * LANES));
    if (!job.exact) {
        for (int i = 0; i < m; i++) {
            const int q = noise.own[i];
            EACH {
                double* const at = rest + i * TILE + v * LANES;
                store(at, load(at) + part.J[q * m + i][v] * load(now + q * TILE + v * LANES));
            }
        }
        for (int j = 0; j < s; j++) {
            const int q = noise.shared[j];
            take_move(part, q, [&](int v) { return -load(now + q * TILE + v * LANES); }, rest);
        }
    }
    reflections.triangularise();
    double* const turned = to.turned;
    memset(turned, 0, sizeof(double) * (m + s) * TILE);
    for (int i = 0; i < m; i++)
        EACH store(turned + i * TILE + v * LANES,
                   load(rest + i * TILE + v * LANES) * load(to.weight + i * TILE + v * LANES));
    reflections.apply(turned);
    for (int i = 0; i < r; i++)
        memcpy(out + ((ptrdiff_t)n * r + i) * PIECE, turned + (u + s + i) * TILE, sizeof(double) * TILE);
    for (int p = 0; p < n; p++) {
        double* const column = to.column;
        reflect_own(to, m, s, part.D + (ptrdiff_t)p * m, part.of_parameter(p), column);
        vec least[TV] = {};
        for (int i = 0; u && i < m; i++)
            EACH {
                const vec a = load(column + i * TILE + v * LANES);
                least[v] += a * a;
            }
        EACH least[v] = all(ROUNDED_AWAY) * root(least[v]);
        reflections.apply(column);
        for (int i = 0; i < r; i++)
            EACH {
                const vec a = load(column + (u + s + i) * TILE + v * LANES);
                store(out + ((ptrdiff_t)p * r + i) * PIECE + v * LANES,
                      choose(magnitude(a) < least[v], all(0.0), a));
            }
    }
    reflections.solve(turned);  // the first u + s rows are the steps now
    if (job.exact)
        memcpy(correction, now, sizeof(double) * k * TILE);
    else
        memset(correction, 0, sizeof(double) * k * TILE);
    for (int j = 0; j < u; j++) {
        const int q = noise.unmeasured[j];
        EACH store(correction + q * TILE + v * LANES,
                   load(now + q * TILE + v * LANES) + load(turned + j * TILE + v * LANES));
        take_move(part, q, [&](int v) { return load(turned + j * TILE + v * LANES); }, rest);
    }
    for (int j = 0; j < s; j++) {
        const int q = noise.shared[j];
        EACH store(correction + q * TILE + v * LANES,
                   load(uncertainty.sds + q * TILE + v * LANES) * load(turned + (u + j) * TILE + v * LANES));
    }
    for (int b = 0; s && b < noise.block_count; b++) {
        const Covariance& block = noise.blocks[b];
        for (int c = 0; c < block.size; c++)
            EACH {
                vec total = {};
                for (int d = 0; d < block.size; d++)
                    total += load(uncertainty.factors[b] + (c * block.size + d) * TILE + v * LANES) *
                             load(turned + (u + block.places[d]) * TILE + v * LANES);
                store(correction + noise.shared[block.places[c]] * TILE + v * LANES, total);
            }
    }
    for (int j = 0; j < s; j++) {
        const int q = noise.shared[j];
        take_move(part, q, [&](int v) { return load(correction + q * TILE + v * LANES); }, rest);
    }
    for (int i = 0; i < m; i++) {
        const int q = noise.own[i];
        EACH {
            const ptrdiff_t at = q * TILE + v * LANES;
            const vec closing = load(rest + i * TILE + v * LANES) / part.J[q * m + i][v];
            const ivec missing = load(uncertainty.sds + at) == all(INFINITY);
            store(correction + at,
                  job.exact ? choose(missing, load(now + at) + closing, load(now + at)) : closing);
        }
    }
}
