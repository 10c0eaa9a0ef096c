// What the Python side hands over, and what the code for each vector width is given and gives back.
// Plain data only: this header is compiled for several processors, and whatever inline function it
// held might be linked in the version for the newest.

#pragma once

#include <stddef.h>
#include <stdint.h>

namespace loopcal {

// Poses run side by side in the registers of a tape.
constexpr int TILE = 32;
// Sums over poses run in this many lanes whatever the processor's, so that all give the same bits.
constexpr int SUMS = 8;
// Poses whose whitened rows are added up together: sums of products want long rows.
constexpr int PIECE = 128;
// What Gauss-Newton has not closed by then is left to Newton, who knows the curvature.
constexpr int MOST_CLOSINGS = 16;
// A step of so many sds leaves a next one that only rounding sees.
constexpr double NEGLIGIBLE = 1e-6;

enum Code : int32_t {
    ADD, SUB, MUL, DIV, NEG, POW, SQUARE, SQRT, SINCOS, TAN, ARCSIN, ARCCOS, ARCTAN, ARCTAN2,
    HYPOT, EXP, LOG, ABS, SIGN,
    PLUS,   // a b + c d
    MINUS,  // a b - c d
    TURN,   // a c - b d and a d + b c
    SIN, COS,  // of numbers only: for poses both come together
    CODES,
};

// Values stand in a workspace in rows of TILE poses; numbers that are the same for all poses too, TILE times.
struct Instruction {
    int32_t code;
    int32_t out[2], in[4];  // where the rows begin
};

// Derivatives by parameters that are multiples of common columns: member i, of common column c where
// ends[c] <= i < ends[c + 1], is the factor factor_of[i] times that column.
struct Multiples {
    int commons, factors, alone;
    const int32_t *factors_at, *members, *factor_of, *ends;
    // parameters that are multiples of none, then the common columns as further parameters: (alone + commons)
    const int32_t* columns;
    // where the sums of each parameter and of E stand: those alone, E, then the members; each part fills blocks of its own
    const int32_t* places;
    int width;  // of all places
};

// A tape ready to run: instructions in stages, and where its outputs stand afterwards: f, then for
// each quantity its derivatives of all loops, then for each parameter and each common column.
struct Program {
    const Instruction* instructions;
    int ends[4];  // of f; with J too; with D but for multiples, common columns and factors; with all
    const int32_t* outputs;
    // for each quantity, parameter and common column, the loops in which its derivative is not always zero:
    // loops_of[ends_of[c] .. ends_of[c + 1])
    const int32_t *loops_of, *ends_of;
    int loops, quantities, parameters;  // of the outputs
    int inputs, known;                  // rows to be filled: all readings, known constants
    Multiples multiples;
    const double* numbers;
    int count;    // of numbers
    int first;    // row of the first input
    size_t room;  // doubles in a workspace of the tape
};

// Rows of poses anywhere in memory: element (i, pose) is at[i * row + pose].
struct Rows {
    const double* at;
    ptrdiff_t row;
};

struct Covariance {
    const int32_t* places;  // among the measured quantities
    int size;
    const double* factor;
    ptrdiff_t by_pose;  // 0, or size^2 where every pose has its own
};

struct Noise {
    const double* sd;
    ptrdiff_t row, by_pose;
    const int32_t* unmeasured;
    int unmeasured_count;
    const int32_t* measured;
    int measured_count;
    const Covariance* blocks;  // places: among the shared, where loops have readings of their own
    int block_count;
    const int32_t* own;     // for each loop the reading that it predicts, or null
    const int32_t* shared;  // the measured quantities beside these
    int shared_count;
};

// Poses to evaluate: outputs[0 .. count) of each pose to out.at[i * out_row + pose].
struct Evaluation {
    const Program* program;
    Rows x, known;
    int stage;
    double* out;
    ptrdiff_t out_row;
};

// Poses to linearise at readings + corrections and to reduce.
struct Reduction {
    const Program* program;
    const Noise* noise;
    Rows readings, corrections, known;
    bool exact, by_parameter;
    bool rounding;  // E of the rounding of loop values in place of the loop values, without corrections
    double* correction;  // (k, poses)
    ptrdiff_t correction_row;
    double* step;       // (poses)
    uint8_t* singular;  // (poses)
    double* rows;       // (n + 1, r, poses), or null
    ptrdiff_t rows_row;
    size_t room;  // doubles in a workspace
};

// Poses whose readings are corrected until their loops close. Of the reduction, without derivatives by parameters:
// where to begin, and where the corrections and the last step of each pose are to stand.
struct Closing {
    Reduction reduction;
    double tolerance, contraction;  // so many sds may be left; of steps, as far as known
    double* ratio;    // (poses) largest of a step to the one before, 0 where there was none
    int32_t* rounds;  // (poses)
    uint8_t* open;    // (poses) whether it did not settle; its corrections are then where to go on from
};

// Poses whose unmeasured quantities are searched for from readings + corrections.
struct Search {
    const Program* program;
    const Noise* noise;
    Rows readings, corrections, known;
    double* change;  // (u, poses)
    ptrdiff_t change_row;
    size_t room;  // doubles in a workspace
};

// The code for one vector width.
struct Width {
    const char* name;
    // doubles in a workspace of any job but an evaluation; parameters: in its outputs
    size_t (*room)(const Program&, const Noise&, int parameters);
    void (*evaluate)(const Evaluation&, int begin, int end, double* workspace);
    // total: (n + 1, n + 1), its lower triangle set to the sums over these poses; or null
    void (*reduce)(const Reduction&, int begin, int end, double* workspace, double* total);
    void (*close)(const Closing&, int begin, int end, double* workspace);
    void (*search)(const Search&, int begin, int end, double* workspace);
};

extern const Width width_2, width_4, width_8;

}  // namespace loopcal
