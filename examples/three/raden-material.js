// A three.js material for a measured surface: `raden export shell.safetensors -o shell.glsl`.
//
//     const material = await RadenMaterial.load("shell.glsl");
//     scene.add(new Mesh(geometry, material));
//
// For WebGLRenderer. It is a MeshLambertMaterial whose reflection is the shell's, so what three does
// with that one it does here: lights, shadows, scene.environment, normal and bump maps, alpha maps,
// instances, skins, morph targets, fog, clipping, tone mapping. `color`, `map`, vertex and instance
// colours are factors on the reflection; white leaves it as it was measured.
import {
  ClampToEdgeWrapping, Data3DTexture, HalfFloatType, LinearFilter, MeshLambertMaterial,
  NoColorSpace, RGBAFormat, Vector3,
} from "three";

const FORMAT = "raden_torch shader table";

// The files of one shell, as `loadShell` reads them; several materials may have one.
export class RadenShell {
  constructor(source, about, texels) {
    if (!source.includes("vec3 raden_brdf("))
      throw new Error("shell: expected a text of `raden export -o shell.glsl`, got another");
    if (about.format !== FORMAT || about.format_version !== 1)
      throw new Error(`shell: expected ${FORMAT} 1, got ${about.format} ${about.format_version}`);
    if (!(about.roughness > 0) || !about.directional_albedo?.length)
      throw new Error("shell: expected a roughness and a directional albedo; export it once more");
    const { width, height, depth } = about;
    if (texels.length !== 4 * width * height * depth)
      throw new Error(`shell: expected ${8 * width * height * depth} bytes, got ${2 * texels.length}`);
    this.source = source;
    this.about = about;
    this.albedo = about.directional_albedo.map((rgb) => new Vector3(...rgb));
    const texture = new Data3DTexture(texels, width, height, depth);
    Object.assign(texture, {
      format: RGBAFormat, type: HalfFloatType, colorSpace: NoColorSpace, generateMipmaps: false,
      minFilter: LinearFilter, magFilter: LinearFilter, wrapS: ClampToEdgeWrapping,
      wrapT: ClampToEdgeWrapping, wrapR: ClampToEdgeWrapping, needsUpdate: true,
    });
    this.texture = texture;
  }

  dispose() {
    this.texture.dispose();
  }
}

// url: of the .glsl file; its description and its table lie beside it.
export async function loadShell(url) {
  const read = async (address) => {
    const response = await fetch(address);
    if (!response.ok) throw new Error(`${address}: expected a file, got HTTP status ${response.status}`);
    return response;
  };
  const address = new URL(url, document.baseURI);
  const about = await (await read(new URL(address.pathname.replace(/\.\w+$/, ".json"), address))).json();
  const [source, bytes] = await Promise.all([
    read(address).then((response) => response.text()),
    read(new URL(about.table, address)).then((response) => response.arrayBuffer()),
  ]);
  return new RadenShell(source, about, new Uint16Array(bytes));
}

// Directions about an axis, evenly by what the two kinds of sample are for: the body over the
// hemisphere, the highlight about the mirror direction by GGX's lobe at normal incidence. Each sample
// counts by the mean of both densities, and reads the environment's level that has been blurred over
// the solid angle it stands for.
const ENVIRONMENT = /* glsl */ `
mat3 radenFrame( const in vec3 axis, const in vec3 side ) {
  return mat3( side, cross( axis, side ), axis );
}
vec3 radenEnvironment( const in vec3 n, const in vec3 v ) {
  vec3 side = cross( n, v );
  // N along V leaves the side open
  side = dot( side, side ) > 1e-8 ? normalize( side )
    : normalize( cross( n, abs( n.x ) < 0.7 ? vec3( 1.0, 0.0, 0.0 ) : vec3( 0.0, 1.0, 0.0 ) ) );
  vec3 mirror = reflect( - v, n );
  mat3 aboutNormal = radenFrame( n, side ), aboutMirror = radenFrame( mirror, side );
  float square = raden_roughness * raden_roughness;
  vec3 sum = vec3( 0.0 );
  for ( int i = 0; i < RADEN_SAMPLES; i ++ ) {
    bool body = ( i & 1 ) == 0;
    float x = ( float( i >> 1 ) + 0.5 ) / float( RADEN_SAMPLES / 2 );
    float turn = PI2 * fract( float( i ) * 0.6180339887 );
    float c = body ? sqrt( x ) : ( 1.0 - x - square * x ) / ( 1.0 - x + square * x );
    float s = sqrt( max( 1.0 - c * c, 0.0 ) );
    vec3 local = vec3( s * cos( turn ), s * sin( turn ), c );
    vec3 l = body ? aboutNormal * local : aboutMirror * local;
    float n_l = dot( n, l );
    if ( n_l <= 0.0 ) continue;
    float lobe = 1.0 - ( 1.0 - square ) * 0.5 * ( 1.0 + dot( mirror, l ) );
    float density = 0.5 * RECIPROCAL_PI * ( n_l + 0.25 * square / ( lobe * lobe ) );
    // GGX's lobe at normal incidence covers 4 pi alpha^2
    float blur = min( pow( RADEN_OVERLAP / ( 4.0 * PI * float( RADEN_SAMPLES ) * density ), 0.25 ), 1.0 );
    vec3 world = transformDirectionByInverseViewMatrix( l, viewMatrix );
    vec3 radiance = textureLod( envMap, envMapRotation * world, roughnessToMip( blur ) ).rgb;
    sum += raden_brdf( n, l, v ) * radiance * ( n_l / density );
  }
  return sum * envMapIntensity / float( RADEN_SAMPLES );
}
`;

const lighting = (shell, samples) => /* glsl */ `
varying vec3 vViewPosition;
${shell.source}
uniform float raden_roughness;
uniform vec3 raden_albedo[ ${shell.albedo.length} ];
#define RADEN_SAMPLES ${samples}
#define RADEN_OVERLAP 1.0

struct RadenMaterial { vec3 factor; };

void RE_Direct_Raden( const in IncidentLight directLight, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in RadenMaterial material, inout ReflectedLight reflectedLight ) {
  vec3 irradiance = directLight.color * saturate( dot( geometryNormal, directLight.direction ) );
  reflectedLight.directDiffuse += irradiance * material.factor
    * raden_brdf( geometryNormal, directLight.direction, geometryViewDir );
}

// light that has no direction: as if the same came from all around
void RE_IndirectDiffuse_Raden( const in vec3 irradiance, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in RadenMaterial material, inout ReflectedLight reflectedLight ) {
  float n_v = dot( geometryNormal, geometryViewDir );
  if ( n_v <= 0.0 ) return;
  float at = sqrt( max( 1.0 - n_v, 0.0 ) ) * ${shell.albedo.length - 1}.0;
  int low = clamp( int( floor( at ) ), 0, ${shell.albedo.length - 2} );
  vec3 albedo = mix( raden_albedo[ low ], raden_albedo[ low + 1 ], saturate( at - float( low ) ) );
  reflectedLight.indirectDiffuse += irradiance * albedo * RECIPROCAL_PI * material.factor;
}

#define RE_Direct RE_Direct_Raden
#define RE_IndirectDiffuse RE_IndirectDiffuse_Raden
#if defined( USE_ENVMAP ) && defined( ENVMAP_TYPE_PMREM )
${ENVIRONMENT}
#endif
`;

const SUM = /* glsl */ `
RE_IndirectDiffuse( irradiance, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
#if defined( USE_ENVMAP ) && defined( ENVMAP_TYPE_PMREM )
  reflectedLight.indirectDiffuse += radenEnvironment( geometryNormal, geometryViewDir ) * material.factor;
#endif
`;

// A surface that reflects as a shell was measured to.
//
// shell: a RadenShell; environmentSamples: directions of scene.environment that a pixel reads, each
// with one look-up of the shell (even, 2…256). Other parameters are MeshLambertMaterial's; envMap,
// specularMap, combine, reflectivity and refractionRatio mean nothing here.
export class RadenMaterial extends MeshLambertMaterial {
  constructor({ shell = null, environmentSamples = 64, ...parameters } = {}) {
    super();
    this.isRadenMaterial = true;
    this._uniforms = { raden_table: { value: null }, raden_albedo: { value: [] }, raden_roughness: { value: 1 } };
    this.shell = shell;
    this.environmentSamples = environmentSamples;
    this.setValues(parameters);
  }

  static async load(url, parameters = {}) {
    return new RadenMaterial({ shell: await loadShell(url), ...parameters });
  }

  get shell() {
    return this._shell;
  }

  set shell(shell) {
    this._shell = shell;
    if (shell) {
      this._uniforms.raden_table.value = shell.texture;
      this._uniforms.raden_albedo.value = shell.albedo;
      this._uniforms.raden_roughness.value = shell.about.roughness;
    }
    this.needsUpdate = true;
  }

  get environmentSamples() {
    return this._samples;
  }

  set environmentSamples(count) {
    if (!(Number.isInteger(count) && count >= 2 && count <= 256 && count % 2 === 0))
      throw new Error(`environmentSamples: expected an even number in 2…256, got ${count}`);
    this._samples = count;
    this.needsUpdate = true;
  }

  onBeforeCompile(shader) {
    if (!this.shell) throw new Error("RadenMaterial: expected a shell, got none; RadenMaterial.load reads one");
    Object.assign(shader.uniforms, this._uniforms);
    const put = (name, text) => {
      const include = `#include <${name}>`;
      if (!shader.fragmentShader.includes(include))
        throw new Error(`RadenMaterial: expected ${include} in three's MeshLambertMaterial, got none; see package.json for three's versions`);
      shader.fragmentShader = shader.fragmentShader.replace(include, () => text);
    };
    put("lights_lambert_pars_fragment", lighting(this.shell, this.environmentSamples));
    put("lights_lambert_fragment", "RadenMaterial material;\nmaterial.factor = diffuseColor.rgb;\n");
    put("lights_fragment_end", SUM);
    put("envmap_fragment", "");
    // colours beyond sRGB are negative; the display's curve takes none
    put("opaque_fragment", "outgoingLight = max( outgoingLight, vec3( 0.0 ) );\n#include <opaque_fragment>");
  }

  customProgramCacheKey() {
    return `${this.environmentSamples} ${this.shell?.albedo.length} ${this.shell?.source}`;
  }

  copy(source) {
    super.copy(source);
    this.shell = source.shell;
    this.environmentSamples = source.environmentSamples;
    return this;
  }
}
