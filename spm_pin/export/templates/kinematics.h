/* Closed-chain kinematics of a {{title}} in C99.

   {{origin}}

   Needs nothing but math.h: no heap, no global state, no recursion, and no loop without a bound, so that all functions
   may be called from several threads and from interrupts. A call with a state `near` takes a time that grows with the
   way from there, bounded by {{most_steps}} steps a stage. The inverse displacement of a calibrated machine without one
   takes 0.2 ms, bounded by {{root_steps}} steps to each of eight roots, four times. All other calls take microseconds.

   Lengths are in metres, forces in newtons, angles in radians. {B} is the frame of the base, with the origin O and Z
   upright; {m} that of the terminal platform, with the origin o; {n} that of the middle platform. Matrices are stored
   row by row. The legs are in the order r_b1, r_b2, r_b3, r_c1, r_c2, r_c3, the lower three first.

   Every function that computes numbers returns a status; where it is not {{PREFIX}}OK, numbers of the result are NaN, but for the
   discriminants of all branches. Arguments may be any numbers. A rotation may be off by rounding: where an entry of
   R^T R - I is larger than 16 eps and at most 1e-6, the nearest rotation is taken. Do not use -ffast-math. */

#ifndef {{PREFIX}}KINEMATICS_H
#define {{PREFIX}}KINEMATICS_H

#ifdef __cplusplus
extern "C" {
#endif

#define {{PREFIX}}VERSION "{{version}}"

enum {{prefix}}status {
{% for name, (value, meaning) in statuses.items() %}
    /* {{meaning}} */
    {{PREFIX}}{{name}} = {{value}}{{"," if not loop.last}}
{% endfor %}
};

/* A machine. Leg i moves in the plane through its pivot that is normal to its axis, and holds the centre of a ball of the
   middle platform there. Its encoder reads the offset and {{readings}}. */
typedef struct {
    double dimensions[3]; /* of the nominal machine: E, O to a lower revolute joint; C, o to an upper one; d */
    double axes[18];      /* unit vectors: of the lower legs in {B}, of the upper legs in {m} */
    double pivots[18];    /* in the same frames */
    double balls[18];     /* in {n} */
    double offsets[6];
    double minimum[6];    /* limits of the readings: see {{prefix}}beyond_limits */
    double maximum[6];    /* INFINITY where there is no limit */
{% for stage, kind, constants in stages if constants %}
    double {{stage}}_{{kind.name|lower}}[{{kind.numbers.size}}]; /* {{constants|join(", ")}} of each {{stage}} leg in turn; the sign is the working mode, +1 or -1 */
{% endfor %}
} {{prefix}}geometry;

/* Names of the members of a geometry and how many numbers each has, in their order, which is that of its file. */
#define {{PREFIX}}FIELDS {% for name, x in fields.items() %}{"{{name}}", {{x.size}}}{{", " if not loop.last}}{% endfor %}


/* A state of the machine. */
typedef struct {
    double rotation[9]; /* R, from {m} to {B} */
    double position[3]; /* o in {B} */
    double joints[9];   /* the balls b_1, b_2, b_3 of the lower legs in {B}, one after the other */
    double readings[6];
} {{prefix}}state;

/* All branches of a pose: TT+, TT-, TF+, TF-, FT+, FT-, FF+, FF-. The letters are the modes of the lower and of the
   upper stage: T without torsion, F turned half round. */
typedef struct {
    double joints[8][9];     /* NaN where a branch is not real */
    double readings[8][6];
    double discriminants[4]; /* of the families TT, TF, FT, FF, dimensionless: real where not negative, a fold at zero */
    int real[8];
} {{prefix}}branches;

/* The machine that this file was generated for. Others may be passed as well. */
extern const {{prefix}}geometry {{prefix}}machine;

{% if bodies is not none %}
/* Masses for `{{prefix}}gravity` [kg, kg m], assumed ones unless the export was given others: mass and first moments of
   the middle platform in {n}, with all balls, and of the terminal platform in {m}; then of each leg the mass of the
   cylinder, and times the distance of its centre from the pivot, and the mass of the rod, and times the distance of its
   centre from the ball. */
extern const double {{prefix}}bodies[32];

{% endif %}
extern const char *const {{prefix}}branch_names[8];

/* Return the name of a status, such as "unreachable". */
const char *{{prefix}}status_name(int status);

/* Inverse displacement. From a state `near`: the end of the way on which the platform moves from its pose in a straight
   line and about a fixed axis, every step proved to stay on the branch, {{PREFIX}}SINGULAR where that meets another.
   With NULL the physical branch: both stages without torsion, upright, and reached from the symmetric home without a
   forward singularity; of two the one within the limits, then the one whose stages are tilted less; of a calibrated
   machine {{PREFIX}}SINGULAR where not all branches can be told apart. `near` and `state` may be the same. */
int {{prefix}}inverse(const {{prefix}}geometry *geometry, const double rotation[9], const double position[3],
        const {{prefix}}state *near, {{prefix}}state *state);

/* Forward displacement. From a state `near`: the end of the way on which the legs change in proportion, whatever its
   mode; {{PREFIX}}SINGULAR where that meets a forward singularity. With NULL the state in the region of the symmetric
   home. `near` and `state` may be the same. */
int {{prefix}}forward(const {{prefix}}geometry *geometry, const double readings[6], const {{prefix}}state *near,
        {{prefix}}state *state);

/* Inverse displacement of a nominal machine: all branches that hold the platform in a pose. */
int {{prefix}}all_branches(const {{prefix}}geometry *geometry, const double rotation[9], const double position[3],
        {{prefix}}branches *branches);

/* Return 0 where all readings are within the limits, up to a rounding of 1e-8 of these, or the number from 1 to 6 of the
   first that is beyond. The functions above do not ask, but for the choice between two physical branches: ask before
   readings are commanded. */
int {{prefix}}beyond_limits(const {{prefix}}geometry *geometry, const double readings[6]);

/* Of a state, which is not checked to close: */

{% for f in functions %}
/* {{f.meaning[0]|upper}}{{f.meaning[1:]}}. */
int {{prefix}}{{f.name}}({{f.parameters(prefix)}});

{% endfor %}
#ifdef __cplusplus
}
#endif

#endif
