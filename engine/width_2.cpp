#define LANES 2
#include "width.inc"

const loopcal::Width loopcal::width_2 = {"128-bit vectors", loopcal::room, loopcal::evaluate, loopcal::reduce, loopcal::close, loopcal::search};
