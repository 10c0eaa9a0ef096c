// Rows of TILE poses in a workspace.

// Room for them, one after the other.
struct Room {
    double* next;
    double* rows(int count) {
        double* const begin = next;
        next += (ptrdiff_t)count * TILE;
        return begin;
    }
};

// One row, somewhere.
struct View {
    const double* at;
    vec operator[](int v) const { return load(at + v * LANES); }
};

static View* views(Room& room, int count) {
    const int rows = (int)(((size_t)count * sizeof(View) + sizeof(double) * TILE - 1) / (sizeof(double) * TILE));
    return (View*)room.rows(rows);
}

// Some of the loops.
struct Loops {
    const int32_t *begin, *end;
};

// What a tape gives, as views: f (m), J (k, m), D (n, m).
struct Linear {
    const View *f, *J, *D;
    const Program* program;

    // those in which the derivative by a quantity, or by a parameter, is not always zero
    Loops of_quantity(int q) const { return of_column(q); }
    Loops of_parameter(int p) const { return of_column(program->quantities + p); }
    Loops of_column(int c) const { return {program->loops_of + program->ends_of[c], program->loops_of + program->ends_of[c + 1]}; }
};

static Linear linear(const Program& program, const double* workspace, int parameters, Room& room) {
    const int m = program.loops, k = program.quantities, outputs = m * (1 + k + parameters);
    View* const all_views = views(room, outputs);
    for (int i = 0; i < outputs; i++) all_views[i] = {workspace + program.outputs[i]};
    return {all_views, all_views + m, all_views + m * (1 + k), &program};
}
