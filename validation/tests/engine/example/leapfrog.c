/* An elastic chain by the leapfrog scheme, as a small code of one's own: leapfrog DECK OUTPUT
 *
 * deck: a comment; time step, steps per sample, samples, bodies; of each body from the lowest up:
 * mass, height, velocity, load, stiffness of the contact below, distance at which it just touches
 * output: for each sample a line with height, velocity and force of the contact below of each body, all of one time */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

typedef struct { double mass, height, velocity, load, stiffness, reach, force; } Body;

static void contacts(Body *body, int bodies) {
    for (int i = 0; i < bodies; i++) {
        double overlap = body[i].reach - (body[i].height - (i ? body[i - 1].height : 0.0));
        body[i].force = overlap > 0 ? body[i].stiffness * overlap * sqrt(overlap) : 0.0;
    }
}

static double acceleration(const Body *body, int i, int bodies) {
    double above = i + 1 < bodies ? body[i + 1].force : 0.0;
    return (body[i].force - above + body[i].load) / body[i].mass;
}

int main(int argc, char **argv) {
    FILE *deck = argc == 3 ? fopen(argv[1], "r") : NULL;
    if (argc != 3) {  /* the only place where this code tells its version */
        fprintf(stdout, "leapfrog 1.0 (compiled " __DATE__ ")\nusage: leapfrog DECK OUTPUT\n");
        return 2;
    }
    double step;
    int every, samples, bodies;
    if (!deck || fscanf(deck, "#%*[^\n]%lf %d %d %d", &step, &every, &samples, &bodies) != 4) {
        fprintf(stderr, "leapfrog: %s is no deck\n", argv[1]);
        return 1;
    }
    Body *body = calloc(bodies, sizeof(Body));
    for (Body *b = body; b < body + bodies; b++)
        if (fscanf(deck, "%lf %lf %lf %lf %lf %lf", &b->mass, &b->height, &b->velocity, &b->load, &b->stiffness,
                   &b->reach) != 6) {
            fprintf(stderr, "leapfrog: the deck ends in body %d\n", (int)(b - body) + 1);
            return 1;
        }
    FILE *output = fopen(argv[2], "w");
    clock_t start = clock();
    contacts(body, bodies);
    for (int i = 0; i < bodies; i++)  /* a leapfrog's velocities are half a step behind */
        body[i].velocity -= 0.5 * step * acceleration(body, i, bodies);
    for (long n = 0; n <= (long)every * (samples - 1); n++) {
        for (int i = 0; i < bodies; i++) {
            double kick = step * acceleration(body, i, bodies);
            if (n % every == 0)  /* forces and velocities meet at the time of the heights */
                fprintf(output, "%.17g %.17g %.17g%c", body[i].height, body[i].velocity + 0.5 * kick, body[i].force,
                        i + 1 < bodies ? ' ' : '\n');
            body[i].velocity += kick;
        }
        for (int i = 0; i < bodies; i++)
            body[i].height += step * body[i].velocity;
        contacts(body, bodies);
    }
    fclose(output);
    printf("loop of %.6f s\n", (double)(clock() - start) / CLOCKS_PER_SEC);
    return 0;
}
