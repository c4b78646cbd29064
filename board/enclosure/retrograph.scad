// The handheld's housing, lights and calibration cap. All lengths in mm; z = 0 is the resting skin, +z towards the camera.
//
//   openscad -D 'part="body"' -D 'board="pi5-imx296"' -o body.stl board/enclosure/retrograph.scad
//
// board: pi5-imx296, pi4-imx477 (for pi4-imx477-binned too). Another magnification is another height: print its own body.
// part: body, led_holder (print 3), gel_frame, camera_plate, tray, saddle, panel_frame, panel_post (print 4), panel_clip (print 4),
// cap, plate (machine it, do not print it), block (cast or machine it of acrylic and polish it), assembly (to look at, cut open;
// with panel_shown=true under its panel).
part = "assembly";
board = "pi5-imx296";
panel_shown = false;        // in the assembly

/* [Optics: what the board profile and the lens say] */
// Of each board: pixel of the sensor in um; pitch at the skin in um (sensor.pixel_pitch_um of the profile); columns and
// rows; extension rings between lens and camera, added up.
boards = [
    ["pi5-imx296", 3.45, 12.0, [1456, 1088], 5 + 1],
    ["pi4-imx477", 1.55, 4.3, [4056, 3040], 5 + 2 + 1],
];
focal = 25;                 // of the lens
hiatus = 0;                 // from the lens's front to its rear principal plane, as its maker states it; negative: crossed
nearest = 300;              // the nearest distance to which the lens focuses without rings
flange = 17.526;            // from a C-mount lens's seat to the sensor, without rings but with the camera's own CS ring
lens = [34, 40];            // the room a lens may take below its seat: diameter, length
sensor_over_board = 1.5;    // from the camera's circuit board to the sensor's face; shim it: the lens focuses the rest

/* [Lights: as board/light-geometry.md has them] */
distance = 25;              // from the skin's centre, inside gel and block
elevation = 30;             // inside the gel
azimuths = [-90, 150, 30];  // red, green, blue, as position_mm of the profiles
leds = 2;                   // in each sleeve, side by side: one for each channel of a light
led = 5.2;                  // room for a 5 mm LED with a flat top, 60 degrees wide or more: a dome would reach through the lip
led_lip = 0.4;              // what stops an LED at the sleeve's front

/* [Gel and block] */
gel_thickness = 2.5;        // slab_thickness_mm of the profile
gel_side = 32;
n_gel = 1.41;               // silicone
n_block = 1.49;             // acrylic
block_top = 16;
facet_at = 24;              // distance of each facet from the skin's centre, along the light's ray

/* [Housing] */
wall = 2.4;
gap = 0.25;                 // between parts that slide; tune to your printer
inner_r = 31;
button_bore = 12.2;
button_z = 48;              // below the lens, above the lights
m25 = 2.9;                  // a screw's way through the part that it holds
m3 = 3.3;
m25_tapped = 2.1;           // the part into which a screw cuts its thread
m3_tapped = 2.5;
m2_tapped = 1.7;
light_board_holes = 9.4;    // between the two screws of a light's circuit board, at the back of its sleeve

/* [Saddle: power bank, or a battery and its switch, strapped on opposite the tray] */
strap = [25, 3];            // hook-and-loop tape: width, and thickness where it lies double
strap_at = 72;              // above the skin: between button and the tray's upper lug
saddle_size = [76, 64];     // along the body, across
switch_hole = [9, 4.6];     // for the body of a slide switch, which is glued in; tune to yours

/* [Calibration cap] */
ball_r = 1.0;               // 2.000 mm bearing balls, grade 10 or better
ball_pitch = 2.5;
balls = [7, 5];
indentation = 0.7;          // how far the cap's rim lets them in: contact to 40 degrees on a 2.5 mm gel
ball_stands_out = 0.95;     // above the plate, which so stays clear of the skin
backing = 2;                // flat glass that the balls stand on

$fn = $preview ? 48 : 72;

// --- what follows from these -----------------------------------------------------------------------------------------

chosen = let(found = search([board], boards)[0])
    assert(is_num(found), str("no housing for board ", board, "; there is one for ", [for (known = boards) known[0]]))
    found;
pixel_um = boards[chosen][1];
pitch_um = boards[chosen][2];
field = boards[chosen][3] * pitch_um / 1000;
rings = boards[chosen][4];
magnification = pixel_um / pitch_um;
working = focal * (1 + 1 / magnification);                          // skin to the lens's front principal plane, in air
optical_shift = (block_top - gel_thickness) * (1 - 1 / n_block) + gel_thickness * (1 - 1 / n_gel);
camera_z = working + optical_shift;                                 // the glass lets the skin seem nearer
sensor_z = camera_z + hiatus + focal * (1 + magnification);
seat_z = sensor_z - flange - rings;                                 // of the lens; its barrel reaches into the body
by_the_lens = focal * magnification - rings;                        // what of the extension is left to its focus ring
plate_height = 4;                                                   // the camera's board lies on this plate
body_top = sensor_z + sensor_over_board - plate_height;
// Snell at the gel's upper face: the ray must stand higher in the block to arrive at `elevation` in the gel.
block_elevation = acos(cos(elevation) * n_gel / n_block);
outer_r = inner_r + wall;
seat_r = inner_r - wall;                                            // where the block sits the wall is twice as thick
screw_r = (seat_r + outer_r) / 2;
tray_from = 18;
tray_at = [38, 98];
tray_face = outer_r + 8;                                            // its back, from the body's axis
tray_length = 133;
plate_thread = 10;                                                  // depth of the threads under the camera's plate
boss_height = 8;
plate_thickness = 2 * ball_r - ball_stands_out;                     // the balls stand on the glass below it
frame_above_skin = 0.5;
led_pitch = led + 0.1;
holder_r = (led_pitch * (leds - 1) + led) / 2 + 1.6;
clear_top = (facet_at - block_top * sin(block_elevation)) / cos(block_elevation);
half_diagonal = norm(field) / 2;

echo(sensor_z = sensor_z, camera_z = camera_z, seat_z = seat_z, by_the_lens = by_the_lens, body_top = body_top);
echo(optical_shift = optical_shift, block_elevation = block_elevation, clear_top = clear_top);
// From the sensor to where the skin seems to lie is f (2 + m + 1 / m), and the lens's hiatus.
assert(abs(body_top + plate_height - sensor_over_board - optical_shift - hiatus
    - focal * (2 + magnification + 1 / magnification)) < 0.01, "the camera stands where its lens cannot focus");
assert(by_the_lens >= 0, "the rings are longer than the lens's extension: take fewer");
assert(by_the_lens <= focal * focal / (nearest - focal), "the lens does not focus this near: put more rings below it");
assert(lens.x / 2 < inner_r, "the lens does not fit the body");
assert(seat_z - lens.y > button_z + button_bore / 2 + 2, "the lens comes down upon the button");
assert(strap_at - strap.x / 2 > button_z + button_bore / 2 + 1, "the strap lies on the button");
assert(strap_at + strap.x / 2 < tray_at[1] - 7, "the strap lies on the tray's upper lug");
assert(led_pitch - led + 2 * led_lip >= 0.8, "the wall between two lips is thinner than two lines of a printer");
assert(light_board_holes / 2 + m2_tapped / 2 + 1 < holder_r, "the light board's screws break out of the sleeve");
assert(tray_at[1] + 7 < body_top - 6, "the tray's upper lug stands in the rim: lower tray_at");
assert(cos(elevation) * n_gel / n_block < 1, "no ray of this elevation reaches the gel out of this block");
assert(clear_top > half_diagonal, "the block's top hides corners of the field: lower block_top or move the facets out");
assert(gel_side / 2 < inner_r - wall, "the gel does not fit the body");
assert(distance > facet_at, "the lights stand inside the block");
assert(facet_at * sin(block_elevation) + led / 2 * cos(block_elevation) <= block_top,
    "the LEDs stand over the block's edge: raise block_top or move the facets in");
assert(indentation < gel_thickness / 2, "the balls are pressed deeper than half the gel");
assert(ball_stands_out >= indentation + 0.2, "the plate touches the skin before the balls are in");
assert(ball_stands_out <= ball_r, "the plate holds less than half of each ball: they fall out");
assert(ball_pitch > 2 * ball_r * sin(40) + 0.8, "the balls stand too near for the skin to come down between them");
assert((balls.x - 1) * ball_pitch + 2 * ball_r < field.x + 2, "the grid is wider than the field");

include <panel.scad>

// --- parts -------------------------------------------------------------------------------------------------------------

// Everything along one light's ray: its axis becomes +z, the skin's centre the origin.
module along_ray(azimuth) rotate([0, 90 - block_elevation, azimuth]) children();

// The clear block: a frustum whose three facets stand square to the rays, so that no light is bent or lost there. Light
// that comes from above through a flat window never arrives lower than acos(1 / n_gel), 45 degrees.
module block() {
    intersection() {
        translate([0, 0, gel_thickness]) cylinder(r = seat_r - gap, h = block_top - gel_thickness);
        for_all_facets() along_ray(0) translate([-60, -60, -60]) cube([120, 120, 60 + facet_at]);
    }
}
module for_all_facets() {
    intersection() {
        rotate(azimuths[0]) children();
        rotate(azimuths[1]) children();
        rotate(azimuths[2]) children();
    }
}

// A sleeve for the LEDs of one light, glued into the body when the light is set: its front end lies on the facet, the LEDs,
// side by side and level, come from outside up to the lip and so stand as near to the facet as the light's distance allows.
module led_holder() {
    length = (outer_r + 3) / cos(block_elevation) - facet_at + 1;       // the circuit board clears the body's boss
    difference() {
        cylinder(r = holder_r, h = length);
        for (i = [0:leds - 1]) translate([0, (i - (leds - 1) / 2) * led_pitch, 0]) {
            translate([0, 0, -1]) cylinder(r = led / 2 - led_lip, h = length + 2);
            translate([0, 0, distance - facet_at]) cylinder(r = led / 2, h = length);
        }
        // One slot for all of them: a wall between their bores would be thinner than a nozzle.
        translate([-led / 2, -led_pitch * (leds - 1) / 2, distance - facet_at]) cube([led, led_pitch * (leds - 1), length]);
        for (x = [-1, 1]) translate([x * light_board_holes / 2, 0, length - 6]) cylinder(r = m2_tapped / 2, h = 7);
    }
}

module body() {
    difference() {
        union() {
            difference() {
                union() {
                    translate([0, 0, gel_thickness]) cylinder(r = outer_r, h = body_top - gel_thickness);
                    translate([0, 0, body_top - 6]) cylinder(r = outer_r + 6, h = 6);
                    for (z = tray_at) translate([0, -7, z - 7]) cube([tray_face, 14, 14]);
                }
                cylinder(r = seat_r, h = block_top + 6);
                translate([0, 0, block_top + 6]) cylinder(r = inner_r, h = body_top);
            }
            // The block is pushed up against these three.
            for (azimuth = azimuths) rotate(azimuth + 180) translate([seat_r - 5, -4, block_top]) cube([7, 8, 4]);
            for (azimuth = azimuths) intersection() {
                along_ray(azimuth) translate([0, 0, seat_r / cos(block_elevation)]) cylinder(r = holder_r + 2.4, h = 10);
                translate([0, 0, gel_thickness]) cylinder(r = outer_r + 4, h = 60);
            }
        }
        for (azimuth = azimuths) along_ray(azimuth)
            translate([0, 0, facet_at]) cylinder(r = holder_r + gap, h = 40);
        for (a = azimuths) rotate(a + 60) translate([screw_r, 0, 0]) cylinder(r = m25_tapped / 2, h = 12);
        translate([0, 0, button_z]) rotate([0, 90, 90]) cylinder(r = button_bore / 2, h = 60);
        translate([-4, -60, body_top - 22]) cube([8, 60, 10]);                        // cables
        // From outside, and no way through: light must not come in here.
        for (z = tray_at) translate([inner_r + 0.6, 0, z]) rotate([0, 90, 0]) cylinder(r = m3_tapped / 2, h = 20);
        for (a = [0:90:270]) rotate(a + 45) translate([outer_r + 2, 0, body_top - plate_thread])
            cylinder(r = m3_tapped / 2, h = plate_thread + 2);
    }
}

// Holds gel and block from below, with three M2.5 screws; its lower face is 0.5 above the skin, so that only gel touches.
module gel_frame() {
    difference() {
        translate([0, 0, frame_above_skin]) cylinder(r = outer_r, h = gel_thickness - frame_above_skin);
        translate([-gel_side / 2, -gel_side / 2, -1]) cube([gel_side, gel_side, 9]);
        for (a = azimuths) rotate(a + 60) translate([screw_r, 0, -1]) cylinder(r = m25 / 2, h = 9);
    }
}

// The camera's circuit board lies on it, face down; mount and lens reach through. The slot lets the tripod foot through.
module camera_plate() {
    difference() {
        cylinder(r = outer_r + 6, h = plate_height);
        translate([0, 0, -1]) cylinder(r = 18, h = plate_height + 2);
        translate([-8, -26, -1]) cube([16, 26, plate_height + 2]);
        for (a = [0:90:270]) rotate(a + 45) translate([outer_r + 2, 0, -1]) cylinder(r = m3 / 2, h = plate_height + 2);
        // Camera Module HQ and Global Shutter Camera: 30 x 30 mm, M2.5.
        for (x = [-15, 15], y = [-15, 15]) translate([x, y, -1]) cylinder(r = m25_tapped / 2, h = plate_height + 2);
    }
}

// Carries a Raspberry Pi 4 or 5 (85 x 56 mm, holes 58 x 49 mm, card towards the skin) and, beside its card, the light
// driver's carrier (30 x 60 mm, holes 24 x 54 mm); screwed to the body's two lugs before the boards are.
carrier_holes = [for (x = [6, 30], y = [6, 60]) [x, y]];
pi_holes = [for (x = [48.5, 48.5 + 58], y = [8.5, 8.5 + 49]) [x, y]];
module tray() {
    difference() {
        union() {
            cube([tray_length, 66, 2.4]);
            for (at = concat(carrier_holes, pi_holes)) translate(at) cylinder(r = 3.2, h = boss_height);
        }
        for (at = concat(carrier_holes, pi_holes)) translate([at.x, at.y, -1])
            cylinder(r = m25_tapped / 2, h = boss_height + 2);
        for (z = tray_at) translate([z - tray_from, 33, -1]) cylinder(r = m3 / 2, h = 9);
    }
}

// Lies on the body opposite the tray, held by one strap around both; a second strap, along it, holds a power bank
// on its plain side. Printed as it stands here, plain side down.
module saddle() {
    plate = 3;
    difference() {
        union() {
            translate([-saddle_size.x / 2, -saddle_size.y / 2, 0]) cube([saddle_size.x, saddle_size.y, plate]);
            translate([-saddle_size.x / 2 + 10, -20, 0]) cube([saddle_size.x - 20, 40, plate + 11]);
        }
        translate([-saddle_size.x, 0, plate + 5 + outer_r]) rotate([0, 90, 0])
            cylinder(r = outer_r + gap, h = 2 * saddle_size.x);
        for (side = [-1, 1]) {
            translate([-strap.x / 2 - 1, side * (saddle_size.y / 2 - 5) - strap.y / 2 - 0.5, -1])
                cube([strap.x + 2, strap.y + 1, plate + 2]);
            translate([side * (saddle_size.x / 2 - 5) - strap.y / 2 - 0.5, -strap.x / 2 - 1, -1])
                cube([strap.y + 1, strap.x + 2, plate + 2]);
        }
        translate([saddle_size.x / 2 - 5 - switch_hole.x, saddle_size.y / 2 - 9, -1]) cube([switch_hole.x, switch_hole.y, 9]);
    }
}

// What the camera's seat and the lens may fill, to look at.
module camera() {
    translate([0, 0, seat_z - lens.y]) cylinder(d = lens.x, h = lens.y);
    translate([0, 0, seat_z]) cylinder(d = 25.4, h = rings + 1);
    translate([0, 0, seat_z + rings]) cylinder(r = 17.5, h = sensor_z - seat_z - rings);
    translate([-19, -19, sensor_z + sensor_over_board]) cube([38, 38, 1.4]);
}

// The plate that keeps the balls in their places, bored through; glued on flat glass, which keeps them in one plane.
module plate() {
    size = [(balls.x + 1) * ball_pitch + 4, (balls.y + 1) * ball_pitch + 4];
    difference() {
        translate([-size.x / 2, -size.y / 2, 0]) cube([size.x, size.y, plate_thickness]);
        for (i = [0:balls.x - 1], j = [0:balls.y - 1])
            translate([(i - (balls.x - 1) / 2) * ball_pitch, (j - (balls.y - 1) / 2) * ball_pitch, -1])
                cylinder(r = ball_r + 0.01, h = plate_thickness + 2, $fn = 24);
    }
}

// Slips over the nose until its floor meets the gel's frame (z = 0): then the balls are in by `indentation`. Plate and
// glass are glued into its pocket.
module cap() {
    size = [(balls.x + 1) * ball_pitch + 4.4, (balls.y + 1) * ball_pitch + 4.4];
    drop = frame_above_skin + ball_stands_out - indentation;        // from the floor down to the plate's face
    pocket = drop + plate_thickness + backing;
    difference() {
        translate([0, 0, -pocket - 2]) cylinder(r = outer_r + gap + wall, h = pocket + 2 + 8);
        cylinder(r = outer_r + gap, h = 20);
        translate([0, 0, -drop]) cylinder(r = gel_side * 0.75, h = 20);
        translate([-size.x / 2, -size.y / 2, -pocket]) cube([size.x, size.y, 20]);
    }
}

// Cut open along the red light's ray.
module assembly() {
    difference() {
        union() {
            color("dimgray") body();
            color("gray") gel_frame();
            color("black") translate([0, 0, body_top]) camera_plate();
            translate([0, 0, -18]) {
                color("goldenrod") translate([0, 0, -plate_thickness - 0.75]) plate();
                color("slategray") cap();
            }
        }
        translate([-150, -100, -60]) cube([150, 200, 300]);
    }
    color("lightblue", 0.5) block();
    color("silver") translate([-gel_side / 2, -gel_side / 2, 0]) cube([gel_side, gel_side, gel_thickness]);
    for (i = [0:2]) color(["red", "green", "blue"][i]) along_ray(azimuths[i]) translate([0, 0, facet_at]) led_holder();
    color("darkgreen") placed_tray();
    color("olive") placed_saddle();
    color("tan") camera();
    if (panel_shown) {
        panel_seat();
        color("midnightblue") panel_glass();
    }
}
module placed_tray() translate([tray_face, -33, tray_from]) rotate([0, -90, 0]) mirror([0, 0, 1]) tray();
module placed_saddle() translate([-outer_r - 8, 0, strap_at]) rotate([0, 90, 0]) saddle();

if (part == "body") body();
else if (part == "led_holder") led_holder();
else if (part == "gel_frame") gel_frame();
else if (part == "camera_plate") camera_plate();
else if (part == "tray") tray();
else if (part == "saddle") saddle();
else if (part == "panel_frame") panel_frame();
else if (part == "panel_post") panel_post();
else if (part == "panel_clip") panel_clip();
else if (part == "cap") cap();
else if (part == "plate") plate();
else if (part == "block") block();
else if (part == "assembly") assembly();
else if (part == "panel_overlap") panel_overlap();                     // empty
else assert(false, str("there is no part ", part));
