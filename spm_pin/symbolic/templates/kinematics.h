/* Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator in C99.

   @ORIGIN@

   Needs nothing but math.h: no heap, no global state, no recursion, and no loop without a bound, so that all functions
   may be called from several threads and from interrupts. With a seed @PREFIX@forward_physical takes a time
   that grows with the path, and is bounded by 500,000 steps, half a second on a desktop processor; all other calls take
   microseconds.

   Lengths are in metres, forces in newtons, angles in radians. {B} is the frame of the base, with the origin O and Z
   upright; {m} that of the terminal platform, with the origin o. Matrices are stored row by row. The legs are in the
   order r_b1, r_b2, r_b3, r_c1, r_c2, r_c3, the lower three first.

   Every function returns a status. Negative ones are errors of the caller. Unless said otherwise, numbers of the result
   are NaN where the status is not @PREFIX_UPPER@OK. Arguments may be any numbers: NaN and infinity are found. A rotation
   may be off by rounding: where an entry of R^T R - I is larger than 16 eps and at most 1e-6, the nearest rotation is
   taken, to second order and twice; where one is larger, or R is a reflection, it is no rotation. Rounding must not be
   changed by the compiler beyond contraction of products and sums: do not use -ffast-math. */

#ifndef @PREFIX_UPPER@KINEMATICS_H
#define @PREFIX_UPPER@KINEMATICS_H

#ifdef __cplusplus
extern "C" {
#endif

#define @PREFIX_UPPER@VERSION "@VERSION@"

enum @PREFIX@status {
    @PREFIX_UPPER@OK = 0,
    @PREFIX_UPPER@UNREACHABLE = 1,     /* no real solution */
    @PREFIX_UPPER@DEGENERATE = 2,      /* a continuous family of solutions; isolated ones beside it are given */
    @PREFIX_UPPER@NOT_PHYSICAL = 4,    /* real solutions, but none of them physical */
    @PREFIX_UPPER@SINGULAR = 5,        /* the state is singular, or the way to it is */
    @PREFIX_UPPER@NOT_FINITE = -1,     /* an argument is NaN or infinite */
    @PREFIX_UPPER@NOT_A_ROTATION = -2, /* R^T R is not I, or R is a reflection */
    @PREFIX_UPPER@BAD_LENGTH = -3,     /* a leg length is not positive, or above 1e5 times E + C + d */
    @PREFIX_UPPER@BAD_GEOMETRY = -4,   /* a dimension is not within 1e-9 to 1e9 m, or not 0 <= minimum < maximum */
    @PREFIX_UPPER@BAD_SEED = -5        /* the state to begin with does not close to 1e-6 d */
};

/* Dimensions. */
typedef struct {
    double base_radius;     /* E, from O to a lower revolute joint */
    double platform_radius; /* C, from o to an upper revolute joint */
    double middle_side;     /* d, side of the middle platform's triangle of ball joints */
    double minimum[6];      /* leg limits, which only decide between two physical branches */
    double maximum[6];      /* INFINITY where there is no limit */
} @PREFIX@geometry;

/* A state of the machine. */
typedef struct {
    double rotation[9]; /* R, from {m} to {B} */
    double position[3]; /* o in {B} */
    double joints[9];   /* the ball joints b_1, b_2, b_3 in {B}, one after the other */
    double lengths[6];
} @PREFIX@state;

/* All branches of a pose: TT+, TT-, TF+, TF-, FT+, FT-, FF+, FF-. The letters are the modes of the lower and of the
   upper stage: T without torsion, F turned half round. */
typedef struct {
    double joints[8][9];     /* NaN where a branch is not real */
    double lengths[8][6];
    double discriminants[4]; /* of the families TT, TF, FT, FF, dimensionless: real where not negative, a fold at zero */
    int real[8];
} @PREFIX@branches;

/* The machine that this file was generated for. Other dimensions may be passed as well. */
extern const @PREFIX@geometry @PREFIX@machine;

extern const char *const @PREFIX@branch_names[8];

/* Return the name of a status, such as "unreachable". */
const char *@PREFIX@status_name(int status);

/* Inverse displacement: all branches that hold the platform in a pose. With @PREFIX_UPPER@UNREACHABLE and
   @PREFIX_UPPER@DEGENERATE the discriminants are numbers, except where the Z axes are parallel. */
int @PREFIX@inverse(const @PREFIX@geometry *geometry, const double rotation[9], const double position[3],
        @PREFIX@branches *branches);

/* Inverse displacement in the physical branch: both stages without torsion, upright, and reached from
   the symmetric home without a forward singularity. Of two the one within the leg limits is taken, then the one whose
   stages are tilted less. */
int @PREFIX@inverse_physical(const @PREFIX@geometry *geometry, const double rotation[9], const double position[3],
        @PREFIX@state *state);

/* Forward displacement. Without a seed, NULL, the state in the aspect of the symmetric home, where there is one at most.
   With a seed the end of the path on which its leg lengths change to the given ones in a straight line, whatever its
   mode; @PREFIX_UPPER@SINGULAR where that path meets a forward singularity, or takes more than 250,000 steps of a stage.
   `seed` and `state` may be the same. */
int @PREFIX@forward_physical(const @PREFIX@geometry *geometry, const double lengths[6], const @PREFIX@state *seed,
        @PREFIX@state *state);

/* J_f (6 x 6, row by row), which maps the platform's twist (v of o, omega), in {B}, to the leg rates. At an inverse
   or a constraint singularity, and where a leg has no length, @PREFIX_UPPER@SINGULAR. The state is not checked to close.
*/
int @PREFIX@inverse_jacobian(const @PREFIX@geometry *geometry, const @PREFIX@state *state, double jacobian[36]);

/* The leg forces that hold a wrench (force, moment at o), in {B}, applied onto the platform; positive pushes. At a
   forward or a constraint singularity @PREFIX_UPPER@SINGULAR. The state is not checked to close. */
int @PREFIX@leg_forces(const @PREFIX@geometry *geometry, const @PREFIX@state *state, const double wrench[6],
        double forces[6]);

#ifdef __cplusplus
}
#endif

#endif
